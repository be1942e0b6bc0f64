// The connection to the server: questions with answers, scenes and poses. It comes back when lost.

const SCENE = 1;
const POSES = 2;
const TRACK = 3;
const RETRY_MS = 1000;

export class Connection {
  // on: { hello, scene, poses, status, lost }
  constructor(on) {
    this.on = on;
    this.waiting = new Map();
    this.next = 1;
    this.connect();
  }

  connect() {
    const token = new URLSearchParams(location.search).get("token");
    const socket = new WebSocket(`ws://${location.host}/socket?token=${encodeURIComponent(token)}`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.text(data) : this.binary(data));
    socket.onclose = () => {
      for (const reject of [...this.waiting.values()].map((each) => each.reject)) {
        reject(new Error("the connection was lost"));
      }
      this.waiting.clear();
      this.on.lost();
      setTimeout(() => this.connect(), RETRY_MS);
    };
    this.socket = socket;
  }

  get isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  send(message) {
    if (this.isOpen) this.socket.send(JSON.stringify(message));
  }

  // Resolves to the answer of a question.
  ask(message) {
    if (!this.isOpen) return Promise.reject(new Error("there is no connection"));
    const id = this.next++;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.send({ ...message, id });
    });
  }

  text(data) {
    const message = JSON.parse(data);
    if (this.waiting.has(message.id)) this.answer(message);
    else if (message.type in this.on) this.on[message.type](message);
  }

  answer(message) {
    const question = this.waiting.get(message.id);
    this.waiting.delete(message.id);
    question?.resolve(message);
  }

  binary(data) {
    const view = new DataView(data);
    const kind = view.getUint32(0, true);
    const count = view.getUint32(4, true);
    if (kind === SCENE) {
      const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 8, count)));
      const meshes = head.geometries.filter((each) => each.vertices);
      const vertices = meshes.reduce((sum, each) => sum + each.vertices[1], 0);
      const faces = meshes.reduce((sum, each) => sum + each.faces[1], 0);
      head.vertices = new Float32Array(data, 8 + count, 3 * vertices);
      head.faces = new Uint32Array(data, 8 + count + 12 * vertices, 3 * faces);
      this.on.scene(head);
    } else if (kind === TRACK) {
      const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 8, count)));
      head.base = new Float32Array(data, 8 + count, 7 * head.links);
      head.poses = new Float32Array(data, 8 + count + 28 * head.links, 7 * head.count * head.rows.length);
      head.all = Uint32Array.from({ length: head.links }, (_, row) => row);
      this.answer(head);
    } else if (kind === POSES) {
      const rows = new Uint32Array(data, 24, count);
      const poses = new Float32Array(data, 24 + 4 * count, 7 * count);
      this.on.poses(rows, poses, view.getFloat64(8, true), view.getFloat64(16, true));
    }
  }
}
