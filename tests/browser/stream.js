// A machine's stream: as much of a WebSocket (RFC 6455) as a machine that sends texts needs.
import { createHash, randomBytes } from "node:crypto";
import { request } from "node:http";

export class Stream {
  static open(address, machine, token) {
    const key = randomBytes(16).toString("base64"), url = new URL(`/v1/machines/${machine}/stream`, address);
    return new Promise((opened, failed) => {
      const asked = request(url, { headers: { authorization: `Bearer ${token}`, connection: "Upgrade", upgrade: "websocket", "sec-websocket-version": "13", "sec-websocket-protocol": "feedwright.v1", "sec-websocket-key": key } });
      asked.on("error", failed);
      asked.on("response", (answer) => { let text = ""; answer.on("data", (part) => { text += part; }); answer.on("end", () => failed(new Error(`${answer.statusCode} ${text}`))); });
      asked.on("upgrade", (answer, socket) => {
        const accept = createHash("sha1").update(`${key}258EAFA5-E914-47DA-95CA-C5AB0DC85B11`).digest("base64");
        if (answer.headers["sec-websocket-accept"] !== accept) { failed(new Error("not a WebSocket")); return; }
        opened(new Stream(socket));
      });
      asked.end();
    });
  }
  constructor(socket) {
    this.socket = socket; this.rest = Buffer.alloc(0); this.waiting = new Map(); this.number = 0;
    socket.on("data", (data) => { this.rest = Buffer.concat([this.rest, data]); while (this.read()); });
    socket.on("close", () => { for (const { failed } of this.waiting.values()) failed(new Error("the stream was closed")); });
    socket.on("error", () => {});
  }
  read() {
    const rest = this.rest;
    if (rest.length < 2) return false;
    let length = rest[1] & 127, head = 2;
    if (length === 126) { if (rest.length < 4) return false; length = rest.readUInt16BE(2); head = 4; } else if (length === 127) { if (rest.length < 10) return false; length = Number(rest.readBigUInt64BE(2)); head = 10; }
    if (rest.length < head + length) return false;
    const kind = rest[0] & 15, content = rest.subarray(head, head + length);
    this.rest = rest.subarray(head + length);
    if (kind === 9) this.frame(10, content);
    if (kind === 1) { const message = JSON.parse(content), asker = this.waiting.get(message.re); if (asker) { this.waiting.delete(message.re); if (message.type === "error") asker.failed(new Error(`${message.code}: ${message.detail} ${JSON.stringify(message.errors ?? "")}`)); else asker.done(message); } }
    return true;
  }
  frame(kind, content) {
    const mask = randomBytes(4), size = content.length, head = size < 126 ? Buffer.from([0x80 | kind, 0x80 | size]) : Buffer.from([0x80 | kind, 0x80 | 126, size >> 8, size & 255]);
    this.socket.write(Buffer.concat([head, mask, content.map((byte, i) => byte ^ mask[i & 3])]));
  }
  /** Sends a message and waits for what answers it. */
  send(message) {
    const n = ++this.number;
    this.frame(1, Buffer.from(JSON.stringify({ ...message, n })));
    return new Promise((done, failed) => this.waiting.set(n, { done, failed }));
  }
  close() { this.socket.destroy(); }
}
