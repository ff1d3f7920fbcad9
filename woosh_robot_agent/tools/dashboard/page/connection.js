// The WebSocket to the dashboard. It reconnects by itself; no message is sent twice.

const RETRY_DELAY = 1000; // milliseconds

export class Connection {
  /**
   * @param {(name: string, data: any, message: any) => void} onPart called with each part
   * @param {(scan: ArrayBuffer) => void} onScan called with each laser scan
   * @param {(open: boolean, reason: string) => void} onOpen called when the connection opens or ends
   */
  constructor(onPart, onScan, onOpen) {
    this.onPart = onPart;
    this.onScan = onScan;
    this.onOpen = onOpen;
    this.robot = 0;
    this.nextId = 1;
    this.replies = new Map();
    document.addEventListener("visibilitychange", () => this.reportVisibility());
    addEventListener("pagehide", () => this.socket.close());
    addEventListener("pageshow", (event) => {
      if (event.persisted) this.connect();
    });
    this.connect();
  }

  connect() {
    clearTimeout(this.retry);
    const socket = new WebSocket(`ws://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      if (this.robot) this.send({do: "watch", robot: this.robot});
      if (document.hidden) this.reportVisibility();
    };
    socket.onmessage = ({data}) => {
      if (typeof data !== "string") {
        this.onScan(data);
        return;
      }
      const message = JSON.parse(data);
      if (message.part === "reply") {
        this.settle(message.id, message.ok, message.text);
      } else if (message.part) {
        if (message.part === "hello") this.onOpen(true, "");
        this.onPart(message.part, message.data);
      }
    };
    socket.onclose = ({reason}) => {
      if (this.socket !== socket) return;
      for (const id of [...this.replies.keys()]) {
        this.settle(id, false, "the connection to the dashboard was lost");
      }
      this.onOpen(false, reason);
      this.retry = setTimeout(() => this.connect(), RETRY_DELAY);
    };
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
    const reply = new Promise((resolve) => this.replies.set(id, resolve));
    this.send({do: "command", id, name, args});
    return reply;
  }

  settle(id, ok, text) {
    this.replies.get(id)?.({ok, text});
    this.replies.delete(id);
  }
}
