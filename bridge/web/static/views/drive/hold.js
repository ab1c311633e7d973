// Manual driving: the page repeats a velocity while a finger is down, and never otherwise.

const AGAIN = 100; // ms between two messages, well below the console's hold_seconds
const GAP = 1000; // ms without running, after which the control may have been released unnoticed

/** One hold at a time. It ends on release, lost focus, a hidden page, a lost connection, after a suspension, and on STOP. */
export class Hold {
  /** `ended`: called when the hold ends, for any reason. */
  constructor(socket, ended) {
    this.socket = socket;
    this.ended = ended;
    this.velocity = null; // null: nothing is held
    this.timer = 0;
    this.ranAt = 0; // by a clock that also counts while the computer is suspended
    const end = () => this.end();
    for (const event of ["blur", "pagehide", "midspan-stop", "hashchange"]) addEventListener(event, end);
    for (const event of ["visibilitychange", "freeze"]) document.addEventListener(event, end);
    socket.addEventListener("state", () => this.allowed() || this.end());
    socket.addEventListener("refused", end);
  }

  allowed() {
    return this.socket.mayDrive && document.visibilityState === "visible" && document.hasFocus();
  }

  /** Start driving, or change the velocity; returns whether driving is allowed. */
  drive(x, y, turn) {
    if (!this.allowed()) {
      this.end();
      return false;
    }
    const begins = this.velocity === null;
    this.velocity = [x, y, turn];
    if (begins) {
      this.ranAt = Date.now();
      this.again();
      this.timer = setInterval(() => this.again(), AGAIN);
    }
    return true;
  }

  again() {
    const [now, before] = [Date.now(), this.ranAt];
    this.ranAt = now;
    if (this.allowed() && now - before < GAP) this.socket.hold(...this.velocity);
    else this.end();
  }

  /** Release immediately. */
  end() {
    if (this.velocity === null) return;
    this.velocity = null;
    clearInterval(this.timer);
    this.socket.release();
    this.ended();
  }
}
