// The WebSocket to the console: feeds, calls, manual driving. See docs/operate/console_protocol.md.

const PROTOCOL = "midspan.console.1";
const FIRST_WAIT = 250;
const LONGEST_WAIT = 2000;
const OPENING = 2500; // ms until an unanswered attempt is aborted
const SILENCE = 2000; // ms without a message until a ping is sent
const ANSWER = 2000; // ms without a reply until the connection counts as dead

/**
 * Connects to the console, and reconnects automatically.
 *
 * Events: `state` (`open`, `hello` or why the connection is lost), `held` (detail: the commanded velocity), `refused`
 * (detail: the reason), `frame` (the newest values have been delivered and should be drawn now).
 */
export class Socket extends EventTarget {
  constructor(address) {
    super();
    this.address = address;
    this.open = false;
    this.hello = null;
    this.link = null;
    this.wait = FIRST_WAIT;
    this.timer = 0;
    this.feeds = new Map(); // name -> {takers, n, value, why, has}
    this.due = new Set(); // feeds whose newest value is not drawn yet
    this.frame = 0;
    this.calls = new Map();
    this.nextId = 1;
    this.receivedAt = 0;
    this.probedAt = 0;
    document.addEventListener("visibilitychange", () => this.watchAll(!document.hidden));
    addEventListener("offline", () => this.lose());
    addEventListener("online", () => this.join());
    setInterval(() => this.listen(), 500);
    this.join();
  }

  get mayDrive() {
    return this.open && this.hello?.role === "drive";
  }

  // -- the connection

  join() {
    clearTimeout(this.timer);
    if (this.link !== null) return;
    const link = new WebSocket(this.address, PROTOCOL);
    this.link = link;
    this.timer = setTimeout(() => this.lose(link), OPENING);
    link.addEventListener("open", () => link === this.link && this.opened());
    link.addEventListener("message", (event) => link === this.link && this.take(event.data));
    link.addEventListener("close", () => this.lose(link));
  }

  opened() {
    clearTimeout(this.timer);
    this.open = true;
    this.wait = FIRST_WAIT;
    this.receivedAt = performance.now();
    this.probedAt = 0;
    this.emit("state");
    this.watchAll(!document.hidden);
  }

  lose(link = this.link) {
    if (link === null || link !== this.link) return;
    clearTimeout(this.timer);
    this.link = null;
    this.open = false;
    this.due.clear();
    link.close();
    for (const call of this.calls.values()) {
      call.failed(new Error("The connection was lost before the reply. The command may have been executed."));
    }
    this.calls.clear();
    this.timer = setTimeout(() => this.join(), this.wait);
    this.wait = Math.min(2 * this.wait, LONGEST_WAIT);
    this.emit("state");
  }

  /** Send a ping after a long silence, because the socket stays open if the network vanishes. */
  listen() {
    const now = performance.now();
    if (!this.open || document.hidden) {
      this.probedAt = 0;
      this.receivedAt = now;
    } else if (this.probedAt && now - this.probedAt > ANSWER) {
      this.lose();
    } else if (!this.probedAt && now - this.receivedAt > SILENCE) {
      this.probedAt = now;
      this.call("ping").catch(() => {}); // any reply shows that the connection is alive
    }
  }

  send(message) {
    if (this.open) this.link.send(JSON.stringify(message));
    return this.open;
  }

  emit(type, detail) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  take(text) {
    this.receivedAt = performance.now();
    this.probedAt = 0;
    const message = JSON.parse(text);
    switch (message.op) {
      case "hello":
        this.hello = message;
        return this.emit("state");
      case "value":
        return this.keep(message);
      case "reply":
        return this.answer(message);
      case "held":
        return this.emit("held", message);
      case "error":
        return this.emit("refused", message.error);
    }
  }

  // -- feeds

  /** Pass the newest value of a feed to `taker(value, why)`, at most once per frame; returns a function that ends this. */
  watch(name, taker) {
    let feed = this.feeds.get(name);
    if (feed === undefined) {
      feed = { takers: new Set(), n: 0, value: null, why: "", has: false };
      this.feeds.set(name, feed);
      if (!document.hidden) this.send({ op: "watch", feed: name });
    }
    feed.takers.add(taker);
    if (feed.has) taker(feed.value, feed.why);
    return () => {
      feed.takers.delete(taker);
      if (feed.takers.size || this.feeds.get(name) !== feed) return;
      this.feeds.delete(name);
      this.due.delete(name);
      if (!document.hidden) this.send({ op: "unwatch", feed: name });
    };
  }

  watchAll(on) {
    if (!on) this.due.clear();
    for (const name of this.feeds.keys()) this.send({ op: on ? "watch" : "unwatch", feed: name });
  }

  keep({ feed: name, n, value, why = "" }) {
    const feed = this.feeds.get(name);
    if (feed === undefined || document.hidden) return;
    Object.assign(feed, { n, value, why, has: true });
    this.due.add(name);
    this.frame ||= requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.frame = 0;
    const drawn = [...this.due];
    this.due.clear();
    for (const name of drawn) {
      const feed = this.feeds.get(name); // an earlier taker may have ended or restarted it
      if (!feed?.has) continue;
      for (const taker of feed.takers) guarded(() => taker(feed.value, feed.why));
    }
    guarded(() => this.emit("frame"));
    for (const name of drawn) {
      const feed = this.feeds.get(name);
      if (feed?.has) this.send({ op: "took", feed: name, n: feed.n });
    }
  }

  // -- calls

  /** Call a verb; resolves with the reply's value, rejects with an Error. Nothing is queued while disconnected. */
  call(verb, args = {}) {
    const id = this.nextId++;
    return new Promise((done, failed) => {
      if (!this.send({ op: "call", id, verb, args })) failed(new Error("No connection, so nothing was sent."));
      else this.calls.set(id, { done, failed });
    });
  }

  answer({ id, ok, value, error }) {
    const call = this.calls.get(id);
    this.calls.delete(id);
    if (ok) call?.done(value);
    else call?.failed(new Error(error));
  }

  // -- manual driving

  /** Send a velocity, unless an earlier message is still unsent, because a late velocity must never drive the robot. */
  hold(x, y, turn) {
    return this.open && this.link.bufferedAmount === 0 && this.send({ op: "hold", x, y, turn });
  }

  release() {
    this.send({ op: "release" });
  }
}

function guarded(action) {
  try {
    action();
  } catch (error) {
    console.error(error);
  }
}
