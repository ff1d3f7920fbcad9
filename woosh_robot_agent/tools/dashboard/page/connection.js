// The WebSocket to the dashboard. It reconnects by itself; no message is sent twice.

/** @typedef {import("./texts.js").Text} Text */
/** @typedef {{ok: boolean, text: Text, data?: any}} Reply */

const RETRY_DELAY = 1000; // milliseconds
const SILENCE = 2000; // milliseconds without a message after which the shown data are outdated
const GIVE_UP = 6000; // milliseconds without a message after which the connection counts as lost
const CONNECT_TIMEOUT = 15000; // milliseconds
const FETCH_TIMEOUT = 5000; // milliseconds; the browser itself may wait for minutes
const FORBIDDEN = 403; // HTTP status
const TOO_MANY_VIEWERS = 1013; // code with which the dashboard closes the connection

export class Connection {
  /**
   * @param {(name: string, data: any) => void} onPart called with each part
   * @param {(scan: ArrayBuffer) => void} onScan called with each laser scan
   * @param {(problem: string) => void} onChange called when the connection becomes good or bad, with
   *   the key of the problem's text; with an empty text if the connection is good
   */
  constructor(onPart, onScan, onChange) {
    this.onPart = onPart;
    this.onScan = onScan;
    this.onChange = onChange;
    this.clock = 0; // newest time from the dashboard; sent back with each command, to detect old ones
    this.nextId = 1;
    /** @type {Map<number, (reply: Reply) => void>} by the id of the command */
    this.replies = new Map();
    /** @type {Map<string, string>} the pieces of a large part that have come, by the name of the part */
    this.pieces = new Map();
    this.isReady = false; // true once the dashboard knows which robot the page shows
    /** @type {Map<string, number>} ids of the stops that wait for the connection, by the robot's address */
    this.unsentStops = new Map();
    this.stopTimeout = 2500; // milliseconds
    this.problem = "link.connecting";
    // when the connection was last heard of, by two clocks: the first one may stand still while the
    // device sleeps, and the second one may be set back
    this.receivedAt = { monotonic: 0, wall: 0 };
    this.retry = 0; // timer of the next attempt
    this.socket = this.connect();
    document.addEventListener("visibilitychange", () => this.reportVisibility());
    addEventListener("pagehide", () => this.socket.close());
    addEventListener("pageshow", (event) => {
      if (event.persisted) this.reconnect(); // the browser has kept the page while another was shown
    });
    setInterval(() => this.checkSilence(), SILENCE / 4);
  }

  connect() {
    clearTimeout(this.retry);
    this.clock = 0;
    this.isReady = false;
    this.heard();
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      if (this.socket === socket) this.heard();
    };
    socket.onmessage = ({ data }) => {
      if (this.socket === socket) this.checkSilence(); // the message may have waited during a sleep
      if (this.socket === socket) this.received(data);
    };
    socket.onclose = ({ code }) => {
      if (this.socket === socket) this.lost(code === TOO_MANY_VIEWERS);
    };
    return socket;
  }

  /** @param {string | ArrayBuffer} data */
  received(data) {
    this.heard();
    this.handle(data);
    if (this.problem) this.setProblem("");
  }

  /** Note that the connection is alive, or is being attempted. */
  heard() {
    this.receivedAt = { monotonic: performance.now(), wall: Date.now() };
  }

  /** @param {string | ArrayBuffer} data */
  handle(data) {
    if (typeof data !== "string") {
      this.onScan(data);
      return;
    }
    const [head, piece] = data.split("\n");
    const message = JSON.parse(head);
    if (piece !== undefined) this.addPiece(message, piece);
    else if (message.part === "clock") this.clock = message.data;
    else if (message.part === "reply") this.settle(message.id, message);
    else if (message.part) this.onPart(message.part, message.data);
  }

  /**
   * Collect the pieces of a part, a text as in a message.
   * @param {{part: string, begin: number, last: boolean}} head  begin: characters before this piece
   * @param {string} piece
   */
  addPiece({ part, begin, last }, piece) {
    const text = begin ? this.pieces.get(part) + piece : piece;
    this.pieces.set(part, last ? "" : text);
    if (last) this.handle(text);
  }

  /**
   * Begin to send, once the dashboard has named its robots.
   * @param {string[]} robots addresses
   * @param {number} shown index of the robot that the page shows
   */
  begin(robots, shown) {
    this.isReady = true;
    if (document.hidden) this.reportVisibility();
    let watched = 0; // the dashboard begins with the first robot
    for (const [robot, id] of this.unsentStops) {
      const stopped = robots.indexOf(robot);
      if (stopped < 0) {
        this.settle(id, failure("reason.robotGone"));
        continue;
      }
      if (stopped !== watched) this.watch(stopped); // a command is for the robot that is watched
      watched = stopped;
      this.sendCommand(id, "stop", {});
    }
    this.unsentStops.clear();
    if (shown !== watched) this.watch(shown);
  }

  /** Show why there is no connection. The browser does not say why it has failed. */
  async findProblem() {
    if (this.problem !== "link.refused") this.setProblem("link.noDashboard");
    const status = await fetch(".", { signal: AbortSignal.timeout(FETCH_TIMEOUT) }).then(
      (response) => response.status,
      () => 0, // no dashboard, or one that hangs
    );
    if (!["link.noDashboard", "link.refused"].includes(this.problem)) return; // connected meanwhile
    this.setProblem(status === FORBIDDEN ? "link.refused" : "link.noDashboard");
  }

  reconnect() {
    const former = this.socket;
    this.lost(false);
    this.connect();
    former.close();
  }

  /**
   * Fail the commands that wait for their answer, except unsent stops, and connect again later.
   * @param {boolean} dismissed true if the dashboard has too many viewers; then do not connect again
   */
  lost(dismissed) {
    clearTimeout(this.retry); // `stop` may reconnect before it is due
    this.isReady = false;
    if (dismissed) this.setProblem("link.dismissed");
    else this.findProblem();
    const unsent = [...this.unsentStops.values()];
    for (const id of [...this.replies.keys()]) {
      if (!unsent.includes(id)) this.settle(id, failure("reason.connectionLost"));
    }
    // too many viewers would otherwise displace one another for ever
    if (!dismissed) this.retry = setTimeout(() => this.connect(), RETRY_DELAY);
  }

  /** Show that the dashboard sends nothing, and in the end open another connection. */
  checkSilence() {
    if (this.socket.readyState === WebSocket.CLOSED) return;
    const { monotonic, wall } = this.receivedAt;
    const silence = Math.max(performance.now() - monotonic, Date.now() - wall);
    const connecting = this.socket.readyState === WebSocket.CONNECTING;
    if (silence > (connecting ? CONNECT_TIMEOUT : GIVE_UP)) {
      this.reconnect();
    } else if (silence > SILENCE && !this.problem) {
      this.setProblem("link.noAnswer");
    }
  }

  /** @param {string} problem key of its text; empty if the connection is good */
  setProblem(problem) {
    this.problem = problem;
    this.onChange(problem);
  }

  /** Send a message; drop it without a connection. @param {Record<string, any>} message */
  send(message) {
    if (this.isReady) this.socket.send(JSON.stringify(message));
  }

  /** @param {number} robot index */
  watch(robot) {
    this.send({ do: "watch", robot });
  }

  reportVisibility() {
    this.send({ do: "visible", visible: !document.hidden });
  }

  /**
   * Send a command.
   * @param {string} name
   * @param {Record<string, any>} args
   * @returns {Promise<Reply>}
   */
  command(name, args = {}) {
    if (!this.isReady) return Promise.resolve(failure("reason.noConnection"));
    const id = this.nextId++;
    this.sendCommand(id, name, args);
    return this.waitForReply(id);
  }

  /**
   * Send a stop: now, or when there is a connection within `stopTimeout`.
   * @param {string} robot address of the robot that the page shows
   */
  stop(robot) {
    this.checkSilence(); // after a sleep of the device, the connection may have ended unseen
    const id = this.nextId++;
    if (this.isReady) {
      this.sendCommand(id, "stop", {});
    } else {
      this.unsentStops.set(robot, id);
      if (this.socket.readyState > WebSocket.OPEN) this.reconnect();
    }
    setTimeout(() => {
      if (this.unsentStops.get(robot) === id) this.unsentStops.delete(robot);
      this.settle(id, failure("reason.noAnswer"));
    }, this.stopTimeout);
    return this.waitForReply(id);
  }

  /**
   * @param {number} id
   * @param {string} name
   * @param {Record<string, any>} args
   */
  sendCommand(id, name, args) {
    this.send({ do: "command", id, name, args, clock: this.clock });
  }

  /**
   * @param {number} id
   * @returns {Promise<Reply>}
   */
  waitForReply(id) {
    return new Promise((resolve) => this.replies.set(id, resolve));
  }

  /**
   * @param {number} id
   * @param {Reply} reply
   */
  settle(id, reply) {
    this.replies.get(id)?.(reply);
    this.replies.delete(id);
  }
}

/**
 * Return what takes the place of an answer that does not come.
 * @param {string} key of the reason
 * @returns {Reply}
 */
function failure(key) {
  return { ok: false, text: { key, values: {} } };
}
