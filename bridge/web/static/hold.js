// Driving by hand: the console is told a velocity again and again while a finger is down, and never without.

const AGAIN = 100; // ms, well within the console's hold_seconds

/** One hold at a time. It ends with the finger, the focus, the sight of the page, the line, and with STOP. */
export class Hold {
  /** `ended`: called when it ends for whatever reason. */
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

  /** Begin to drive, or drive otherwise from now on; returns whether it may. */
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

  /** Let go at once. */
  end() {
    if (this.velocity === null) return;
    this.velocity = null;
    clearInterval(this.timer);
    this.socket.release();
    this.ended();
  }
}
