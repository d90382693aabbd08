// One field or mesh on the page: the frames it has, and which it fetches next.

const ROOM = 600e6; // bytes of frames that all panes together keep

class Pane {
  constructor(number, meta, viewer) {
    Object.assign(this, { number, meta, viewer, left: 0, width: 0, frames: new Map(), shown: null, error: "", plane: null });
    this.flat = meta.space === 2;
    [this.lower, this.upper] = [meta.lower, meta.upper];
  }

  // The time of the page as this pane has it: as many parameters as there are sliders that concern it.
  time(values = this.viewer.values) {
    return values.slice(0, this.meta.times.length);
  }

  key(resolution, values) {
    return `${resolution}:${this.time(values).join()}`;
  }

  has(resolution, values) {
    return this.frames.get(this.key(resolution, values));
  }

  best(values) {
    const { resolution, preview } = this.viewer.meta;
    return this.has(resolution, values) || this.has(preview, values);
  }

  // Shows the best frame there is for the current time; whether there is one.
  swap() {
    const frame = this.best();
    if (frame) this.shown = frame;
    return Boolean(frame);
  }

  async fetch(resolution, values, rank, signal) {
    const key = this.key(resolution, values);
    const frame = await this.viewer.source.frame(this.number, this.time(values), { resolution, rank, glance: this.viewer.glance, signal });
    if (this.frames.has(key)) return;
    const mesh = frame.position && this.viewer.drawing.upload(frame, this.meta.scale);
    const bytes = frame.position ? 4 * (2 * frame.position.length + 2 * frame.index.length) : 100;
    this.frames.set(key, { ...frame, mesh, resolution, bytes, values: this.time(values), used: performance.now() });
    this.viewer.makeRoom();
  }

  // The current frame: a preview first, then the fine one once the eye rests.
  async look() {
    const { viewer } = this, { resolution, preview } = viewer.meta, glance = viewer.glance, values = [...viewer.values];
    this.error = "";
    this.stop?.abort();
    const stop = (this.stop = new AbortController());
    const current = () => glance === viewer.glance;
    try {
      if (!this.best(values)) {
        // One preview is under way at a time; the next is for where the slider is by then.
        if (this.previewing) return;
        this.previewing = true;
        try {
          await this.fetch(preview, values, 0);
        } finally {
          this.previewing = false;
        }
        if (!current()) return this.look();
        viewer.changed();
      }
      if (this.has(resolution, values)) return;
      await new Promise((resolve) => setTimeout(resolve, 150));
      if (!current() || viewer.playing) return;
      await this.fetch(resolution, values, 1, stop.signal);
      if (current()) viewer.changed();
    } catch (error) {
      if (error.name === "AbortError" || error.superseded) return;
      if (!current()) return this.look();
      this.error = error.message;
      this.shown = null;
      viewer.changed();
    }
  }

  // Frames around the current time, nearest first and those ahead before those behind: previews, then fine ones.
  *around() {
    const { viewer } = this, { resolution, preview, times } = viewer.meta;
    const far = (axis) => (axis === viewer.axis ? times[axis].length : 2);
    for (const [kind, most] of [[preview, Infinity], [resolution, 4]])
      for (let axis = 0; axis < this.meta.times.length; axis++)
        for (let step = 1; step <= Math.min(far(axis), most); step++)
          for (const place of [viewer.places[axis] + step, viewer.places[axis] - step]) {
            const [a, b] = this.meta.times[axis], value = times[axis][place];
            if (!(value >= a && value <= b)) continue;
            const values = viewer.moved(axis, value);
            if (!this.has(kind, values)) yield [kind, values];
          }
  }

  async prepare() {
    if (this.preparing) return;
    this.preparing = true;
    for (;;) {
      const next = this.best() && this.around().next().value;
      if (!next || this.viewer.isFull()) break;
      try {
        await this.fetch(next[0], next[1], 2);
      } catch {
        break; // it will be asked for again, and then answered, when it is looked at
      }
      this.viewer.marks();
    }
    this.preparing = false;
  }

  // The level sets on the cut: a coarse texture while it moves, a fine one when it rests.
  async slice(cut) {
    const glance = this.viewer.glance;
    this.wanted = cut && `${cut.axis}:${cut.offset}:${glance}`;
    if (!cut || this.slicing) return;
    this.slicing = true;
    const wanted = this.wanted, time = this.time();
    try {
      for (const n of [72, 224]) {
        const values = await this.viewer.source.plane(this.number, time, { ...cut, n });
        if (this.plane) this.viewer.drawing.gl.deleteTexture(this.plane.texture);
        this.plane = { ...cut, texture: this.viewer.drawing.texture(values, n), wanted };
        this.viewer.changed();
        if (wanted !== this.wanted) break;
      }
    } catch {
      this.plane = null;
    }
    this.slicing = false;
    if (this.wanted && wanted !== this.wanted) this.slice(this.viewer.cut);
  }
}
