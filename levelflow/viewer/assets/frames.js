// Where frames come from: the server, or this file. Both answer the same questions.

// A packed surface (levelflow/viewer/packing.py): positions in the units of the page, normals, quantities, triangles.
function decode(buffer) {
  const view = new DataView(buffer);
  if (view.getUint32(0, true) !== 0x3146564c) throw new Error("These are not the bytes of a surface.");
  const start = 8 + view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, start - 8)));
  const kinds = { float32: Float32Array, uint8: Uint8Array, uint16: Uint16Array, int32: Int32Array };
  const arrays = {};
  for (const { name, type, width, offset, count, lower, step } of header.arrays) {
    const numbers = new kinds[type](buffer, start + offset, count * width);
    arrays[name] = step === undefined ? numbers : Float32Array.from(numbers, (n) => lower + step * n);
  }
  const { position, normal, index, ...quantities } = arrays;
  if (!position) return { ...header, position: null };
  const corners = new Uint32Array(index.length);
  for (let i = 0, sum = 0; i < index.length; i++) corners[i] = sum += index[i];
  return { ...header, position, normal, quantities, index: corners };
}

// What the server answers, or its sentence as an error.
class ServerSource {
  constructor() {
    this.page = crypto.getRandomValues(new Uint32Array(2)).join("");
    this.formats = ["ply", "stl", "glb", "usdc"];
  }

  async ask(path, query, options) {
    const answer = await fetch(`${path}?${new URLSearchParams(query)}`, options);
    if (!answer.ok) throw new Error((await answer.json()).error);
    // Nothing: the server gave up what this page wanted soon, because it asked for something else.
    if (answer.status === 204) throw Object.assign(new Error("superseded"), { superseded: true });
    return answer.arrayBuffer();
  }

  async frame(field, time, { resolution, rank, glance, signal }) {
    return decode(await this.ask("frame", { field, t: time.join(), resolution, rank, glance, page: this.page }, { signal }));
  }

  async plane(field, time, { axis, offset, n, signal }) {
    return new Float32Array(await this.ask("plane", { field, t: time.join(), axis, offset, n }, { signal }));
  }

  tell(path, query, body, signal) {
    return this.ask(path, query, { method: "POST", headers: { "Content-Type": "application/json" }, body, signal });
  }

  // The surface after an edit by handles.
  async deformed(text, query, signal) {
    return decode(await this.tell("deformed", { ...query, page: this.page }, text, signal));
  }

  async save(text) {
    await this.tell("handles", {}, text);
  }

  async file(field, time, format) {
    return new Blob([await this.ask("export", { field, t: time.join(), format })], { type: "application/octet-stream" });
  }
}

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}

// The frames in the file. A plane is read off a grid of values by trilinear interpolation.
class EmbeddedSource {
  constructor({ grid, packed }) {
    this.grid = grid;
    // Numbers are compared as numbers: Python and JavaScript write some of them differently.
    this.packed = packed.map((mine) => Object.entries(mine).map(([key, value]) => [key.split(",").filter(Boolean).map(Number), value]));
    this.formats = ["ply"];
    this.grids = new Map();
  }

  entry(field, time) {
    const found = this.packed[field].find(([key]) => key.length === time.length && key.every((t, i) => t === time[i]));
    if (!found) throw new Error(`t = ${time.join()} is not in this file.`);
    return found[1];
  }

  async frame(field, time) {
    return decode(await inflate(this.entry(field, time).surface));
  }

  async values(field, time) {
    const key = `${field}:${time}`;
    if (!this.grids.has(key)) {
      const buffer = await inflate(this.entry(field, time).grid);
      const most = new DataView(buffer).getFloat32(0, true);
      this.grids.set(key, Float32Array.from(new Int8Array(buffer, 4), (q) => (most * q * Math.abs(q)) / 127 ** 2));
    }
    return this.grids.get(key);
  }

  async plane(field, time, { axis, offset, n }) {
    const g = this.grid, values = await this.values(field, time), out = new Float32Array(n * n);
    const flat = values.length === g * g;
    const at = (x, y, z) => values[(flat ? 0 : z * g * g) + y * g + x];
    for (let j = 0; j < n; j++)
      for (let i = 0; i < n; i++) {
        const p = [0, 0, 0];
        p[axis] = offset;
        p[(axis + 1) % 3] = (2 * i) / (n - 1) - 1;
        p[(axis + 2) % 3] = (2 * j) / (n - 1) - 1;
        const cell = p.map((c) => clamp(Math.floor(((c + 1) / 2) * (g - 1)), 0, g - 2));
        const w = p.map((c, k) => ((c + 1) / 2) * (g - 1) - cell[k]);
        let sum = 0;
        for (let corner = 0; corner < (flat ? 4 : 8); corner++) {
          const b = [corner & 1, (corner >> 1) & 1, corner >> 2];
          const weight = b.reduce((product, bit, k) => product * (flat && k === 2 ? 1 : bit ? w[k] : 1 - w[k]), 1);
          sum += weight * at(cell[0] + b[0], cell[1] + b[1], cell[2] + b[2]);
        }
        out[j * n + i] = sum;
      }
    return out;
  }

  // Binary PLY, in the units of the shape.
  async file(field, time, format, { center, scale }) {
    const { position, normal, index } = await this.frame(field, time);
    if (!position) throw new Error("There is no surface to save at this time.");
    const n = position.length / 3, m = index.length / 3;
    const names = ["x", "y", "z", "nx", "ny", "nz"].map((name) => `property float ${name}\n`).join("");
    const head = new TextEncoder().encode(
      `ply\nformat binary_little_endian 1.0\ncomment written by levelflow\nelement vertex ${n}\n${names}` +
        `element face ${m}\nproperty list uchar int vertex_indices\nend_header\n`,
    );
    const body = new DataView(new ArrayBuffer(24 * n + 13 * m));
    for (let i = 0; i < n; i++)
      for (let k = 0; k < 3; k++) {
        body.setFloat32(24 * i + 4 * k, center[k] + scale * position[3 * i + k], true);
        body.setFloat32(24 * i + 12 + 4 * k, normal[3 * i + k], true);
      }
    for (let i = 0; i < m; i++) {
      body.setUint8(24 * n + 13 * i, 3);
      for (let k = 0; k < 3; k++) body.setInt32(24 * n + 13 * i + 1 + 4 * k, index[3 * i + k], true);
    }
    return new Blob([head, body], { type: "application/octet-stream" });
  }
}
