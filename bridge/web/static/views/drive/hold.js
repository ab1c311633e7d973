// Manual driving: the page repeats a velocity while a finger is down, and never otherwise.

const AGAIN = 100; // ms between two messages, well below the console's hold_seconds

/** One hold at a time. It ends on release, lost focus, a hidden page, a lost connection, and STOP. */
export class Hold {
  /** `ended`: called when the hold ends, for any reason. */
  constructor(socket, ended) {
    this.socket = socket;
    this.ended = ended;
    this.velocity = null; // null: nothing is held
    this.timer = 0;
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
      this.again();
      this.timer = setInterval(() => this.again(), AGAIN);
    }
    return true;
  }

  again() {
    if (this.allowed()) this.socket.hold(...this.velocity);
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
