// The WebSocket to the dashboard. It reconnects by itself; no message is sent twice.

const RETRY_DELAY = 1000; // milliseconds
const SILENCE = 2000; // milliseconds without a message after which what is shown counts as outdated
const GIVE_UP = 6000; // milliseconds without a message after which the connection counts as lost
const CONNECT_TIMEOUT = 15000; // milliseconds
const STOP_TIMEOUT = 2500; // milliseconds
const TOO_MANY_VIEWERS = 1013; // code with which the dashboard closes the connection

export class Connection {
  /**
   * @param {(name: string, data: any) => void} onPart called with each part
   * @param {(scan: ArrayBuffer) => void} onScan called with each laser scan
   * @param {(problem: string) => void} onChange called when the connection becomes good or bad, with
   *   the problem; empty if it is good
   */
  constructor(onPart, onScan, onChange) {
    this.onPart = onPart;
    this.onScan = onScan;
    this.onChange = onChange;
    this.robot = 0;
    this.nextId = 1;
    this.replies = new Map(); // functions that take the reply, by the id of the command
    this.unsentStop = 0; // id of a stop that waits for the connection
    this.problem = "connecting";
    document.addEventListener("visibilitychange", () => this.reportVisibility());
    addEventListener("pagehide", () => this.socket.close());
    addEventListener("pageshow", (event) => {
      if (event.persisted) this.connect();
    });
    setInterval(() => this.checkSilence(), SILENCE / 4);
    this.connect();
  }

  connect() {
    clearTimeout(this.retry);
    this.clock = 0; // newest time of the dashboard, which goes back with everything that moves
    this.heardAt = performance.now();
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      if (this.socket !== socket) return;
      if (this.robot) this.send({do: "watch", robot: this.robot});
      if (document.hidden) this.reportVisibility();
      if (this.unsentStop) this.sendCommand(this.unsentStop, "stop", {});
      this.unsentStop = 0;
    };
    socket.onmessage = ({data}) => {
      if (this.socket === socket) this.received(data);
    };
    socket.onclose = ({code, reason}) => {
      if (this.socket === socket) this.lost(reason, code !== TOO_MANY_VIEWERS);
    };
  }

  received(data) {
    this.heardAt = performance.now();
    if (this.problem) this.change("");
    if (typeof data !== "string") {
      this.onScan(data);
      return;
    }
    const message = JSON.parse(data);
    if (message.part === "clock") this.clock = message.data;
    else if (message.part === "reply") this.settle(message.id, message.ok, message.text);
    else if (message.part) this.onPart(message.part, message.data);
  }

  lost(reason, retry) {
    this.change(`no connection to the dashboard${reason && `: ${reason}`}`);
    for (const id of [...this.replies.keys()]) {
      if (id !== this.unsentStop) this.settle(id, false, "the connection to the dashboard was lost");
    }
    if (retry) this.retry = setTimeout(() => this.connect(), RETRY_DELAY);
  }

  checkSilence() {
    if (this.socket.readyState === WebSocket.CLOSED) return;
    const silence = performance.now() - this.heardAt;
    const connecting = this.socket.readyState === WebSocket.CONNECTING;
    if (silence > (connecting ? CONNECT_TIMEOUT : GIVE_UP)) {
      const former = this.socket;
      this.connect();
      former.close();
      this.lost("it does not answer", false);
    } else if (silence > SILENCE && !this.problem) {
      this.change("no answer from the dashboard");
    }
  }

  change(problem) {
    this.problem = problem;
    this.onChange(problem);
  }

  get isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  send(message) {
    if (this.isOpen) this.socket.send(JSON.stringify(message));
  }

  watch(robot) {
    this.robot = robot;
    this.send({do: "watch", robot});
  }

  reportVisibility() {
    this.send({do: "visible", visible: !document.hidden});
  }

  /** Send a command; return a promise of {ok, text}. */
  command(name, args = {}) {
    if (!this.isOpen) {
      return Promise.resolve({ok: false, text: "there is no connection to the dashboard"});
    }
    const id = this.nextId++;
    this.sendCommand(id, name, args);
    return this.reply(id);
  }

  /** Send a stop, if need be as soon as there is a connection; return a promise of {ok, text}. */
  stop() {
    const id = this.nextId++;
    if (this.isOpen) {
      this.sendCommand(id, "stop", {});
    } else {
      this.unsentStop = id;
      if (this.socket.readyState !== WebSocket.CONNECTING) this.connect();
    }
    setTimeout(() => {
      if (this.unsentStop === id) this.unsentStop = 0;
      this.settle(id, false, "no answer");
    }, STOP_TIMEOUT);
    return this.reply(id);
  }

  sendCommand(id, name, args) {
    this.send({do: "command", id, name, args, clock: this.clock});
  }

  reply(id) {
    return new Promise((resolve) => this.replies.set(id, resolve));
  }

  settle(id, ok, text) {
    this.replies.get(id)?.({ok, text});
    this.replies.delete(id);
  }
}
