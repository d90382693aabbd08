// The page: what is looked at, and the controls.

const $ = (id) => document.getElementById(id);
const make = (tag, properties = {}, ...children) => {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
};
const icon = (path) => `<svg width="14" height="14" viewBox="0 0 14 14" fill="currentColor"><path d="${path}"/></svg>`;
const PLAY = icon("M3 1l9 6-9 6z"), PAUSE = icon("M2 1h3.5v12H2zM8.5 1H12v12H8.5z");
const FRAMES_PER_SECOND = 12;

class Viewer {
  constructor() {
    this.meta = JSON.parse($("meta").textContent);
    const frames = JSON.parse($("frames").textContent);
    this.source = frames ? new EmbeddedSource(frames) : new ServerSource();
    this.drawing = new Drawing($("canvas"));
    this.places = this.meta.times.map(() => 0);
    this.values = this.meta.times.map((values) => values[0]);
    Object.assign(this, { axis: 0, glance: 0, playing: 0, colour: "", range: [-1, 1], cut: null, points: [], measuring: false });
    this.swaps = []; // milliseconds that it took to show a frame that was there
    this.panes = this.meta.viewed.map((one, i) => new Pane(i, one, this));
    this.shares = this.panes.map((pane) => pane.meta.shares).find((names) => names.length) ?? [];
    this.camera = new Camera(this.panes.every((pane) => pane.flat));
    this.labels();
    this.sliders();
    this.tools();
    this.pointer();
    this.editing = null;
    addEventListener("resize", () => (this.place(), this.redraw()));
    addEventListener("keydown", (event) => this.key(event));
    this.place();
    if (this.meta.editing) this.editing = new Editing(this);
    this.look();
  }

  // Time.

  async look() {
    this.glance += 1;
    const started = performance.now();
    const ready = this.panes.map((pane) => pane.swap());
    if (ready.every(Boolean) && this.framed) {
      this.draw();
      this.drawing.finish();
      this.swaps.push(performance.now() - started);
    }
    this.changed();
    await Promise.all(this.panes.map((pane) => pane.look()));
  }

  // To a place of a slider, or to any value.
  go(axis, place, value = this.meta.times[axis][place]) {
    this.axis = axis;
    this.values = this.moved(axis, value);
    this.places = this.values.map((t, i) => (i === axis ? place : this.nearest(i, t)));
    this.look();
  }

  // All values when one of them changes. Shares of a mixture are at most 1 together: the others give way in proportion.
  moved(axis, value) {
    const number = this.shares.length - 1, values = this.values.with(axis, value);
    const others = values.slice(0, number).reduce((sum, t, i) => (i === axis ? sum : sum + t), 0);
    if (axis >= number || value + others <= 1) return values;
    return values.map((t, i) => (i === axis || i >= number ? t : Number((((1 - value) * t) / others).toFixed(9))));
  }

  nearest(axis, value) {
    const times = this.meta.times[axis];
    return times.reduce((best, t, i) => (Math.abs(t - value) < Math.abs(times[best] - value) ? i : best), 0);
  }

  step(by) {
    if (!this.meta.times.length) return;
    const n = this.meta.times[this.axis].length;
    this.go(this.axis, (this.places[this.axis] + by + n) % n);
  }

  // Each frame is shown before the next one comes, so the first round goes as fast as frames are made.
  play(axis = this.axis) {
    if (this.playing) {
      clearInterval(this.playing);
      this.playing = 0;
      this.look();
    } else if (this.meta.times.length) {
      this.axis = axis;
      this.playing = setInterval(() => {
        if (this.panes.every((pane) => pane.best() || pane.error)) this.step(1);
      }, 1000 / FRAMES_PER_SECOND);
    }
    this.redraw();
  }

  // What is shown has changed: a frame came, or another is wanted.
  changed() {
    for (const pane of this.panes) {
      pane.swap();
      pane.slice(this.cutOf(pane));
    }
    if (!this.framed && this.panes.every((pane) => pane.shown || pane.error)) this.frame();
    if (this.panes.every((pane) => pane.best() || pane.error)) for (const pane of this.panes) pane.prepare();
    this.redraw();
  }

  frame() {
    const clouds = this.panes.filter((pane) => pane.shown?.position).map((pane) => pane.shown.position);
    if (!clouds.length) return;
    this.framed = true;
    this.camera.frame(clouds, this.panes[0].width, $("stage").clientHeight);
  }

  isFull() {
    return this.panes.reduce((sum, pane) => sum + [...pane.frames.values()].reduce((s, frame) => s + frame.bytes, 0), 0) > 0.9 * ROOM;
  }

  // Frames that were not used for longest go.
  makeRoom() {
    const all = this.panes.flatMap((pane) => [...pane.frames].map(([key, frame]) => ({ pane, key, frame })));
    let bytes = all.reduce((sum, { frame }) => sum + frame.bytes, 0);
    for (const { pane, key, frame } of all.sort((a, b) => a.frame.used - b.frame.used)) {
      if (bytes <= ROOM) return;
      if (frame === pane.shown) continue;
      pane.frames.delete(key);
      if (frame.mesh) this.drawing.forget(frame.mesh);
      bytes -= frame.bytes;
    }
  }

  // Pictures.

  redraw() {
    this.due ??= requestAnimationFrame(() => {
      this.due = null;
      this.draw();
      this.write();
      clearTimeout(this.rest);
      if (this.drawing.software) this.rest = setTimeout(() => this.playing || this.draw({ resting: true }), 250);
    });
  }

  draw({ resting = false } = {}) {
    this.editing?.paint();
    const panes = this.panes.map((pane) => ({
      ...pane,
      mesh: this.frameOf(pane)?.mesh,
      plane: $("contours").checked && this.cutOf(pane) && pane.shown?.position && pane.plane,
      spacing: this.spacing(pane) / pane.meta.scale,
    }));
    for (const pane of this.panes) if (pane.shown) pane.shown.used = performance.now();
    this.drawing.draw(panes, this.camera, { quantity: this.colour, range: this.range, cut: this.cut, resting });
  }

  // What is drawn: a frame, or the surface after an edit.
  frameOf(pane) {
    return this.editing && pane === this.editing.pane ? this.editing.frame : pane.shown;
  }

  // A curve in the plane has the level sets of its whole plane.
  cutOf(pane) {
    if (pane.flat) return $("contours").checked ? { axis: 2, offset: -1e-3 } : null;
    return this.cut;
  }

  spacing(pane) {
    return round125(pane.meta.scale / 20);
  }

  place() {
    const width = $("stage").clientWidth / this.panes.length;
    this.panes.forEach((pane, i) => {
      Object.assign(pane, { left: i * width, width });
      pane.label.style.cssText = `left: ${i * width}px; width: ${width}px; height: 100%`;
    });
  }

  // Words.

  labels() {
    for (const pane of this.panes) {
      const [title, state, note] = [make("h2", { textContent: pane.meta.name, title: pane.meta.name }), make("p"), make("p", { className: "note" })];
      note.style.cssText = "top: 50%; left: 50%";
      Object.assign(pane, { label: make("div", { className: "label" }, title, state, note), state, note });
      if (pane.number) pane.label.append(make("div", { className: "pane-edge" }));
      $("labels").append(pane.label);
    }
  }

  // All text that depends on what is shown.
  write() {
    for (const pane of this.panes) {
      const { shown, error } = pane;
      const faces = shown?.position ? `${(shown.index.length / 3).toLocaleString("en")} triangles` : "";
      const waits = !error && !pane.best();
      const kind = !pane.meta.times.length || !shown?.position ? "" : shown.resolution < this.meta.resolution ? " · preview" : "";
      const rest = pane.meta.shares.length ? ` · ${pane.meta.shares[0]} ${short(Math.max(1 - pane.time().reduce((sum, t) => sum + t, 0), 0), 3)}` : "";
      const edited = this.frameOf(pane) !== shown;
      pane.state.textContent = edited ? `preview of the edit${this.editing.error && ", before the last change"}` : waits ? "computing …" : faces + kind + rest;
      pane.note.textContent = error || shown?.note || "";
    }
    document.body.dataset.ready = String(this.panes.every((pane) => pane.best() || pane.error));
    document.body.dataset.time = this.values.join();
    this.marks();
    this.colours();
    this.measured();
    this.editing?.markers();
  }

  sliders() {
    this.rows = this.meta.times.map((times, axis) => {
      const name = this.shares[axis + 1] ?? (this.meta.times.length > 1 ? `t${"₁₂₃₄₅₆₇₈₉"[axis] ?? axis + 1}` : "t");
      const play = make("button", { type: "button", className: "play", title: "Play (space)", innerHTML: PLAY });
      const range = make("input", { type: "range", min: 0, max: times.length - 1, step: 1, value: 0, ariaLabel: `time ${name}` });
      const ready = make("div", { className: "ready" }, ...times.map(() => make("i")));
      const text = make("input", { type: "text", inputMode: "decimal", ariaLabel: `value of ${name}`, title: "Any time: type it" });
      play.onclick = () => this.play(axis);
      range.oninput = () => {
        if (this.playing) this.play();
        this.go(axis, Number(range.value));
      };
      text.onchange = () => this.type(axis, text.value);
      $("times").append(make("div", { className: "time" }, play, make("div", { className: "track" }, range, ready), make("b", { textContent: name }), text));
      return { play, range, ready, text };
    });
  }

  type(axis, text) {
    const value = text.trim() === "" ? NaN : Number(text), times = this.meta.times[axis];
    if (!Number.isFinite(value)) return this.say(`“${text}” is not a number; type a time from ${short(times[0], 6)} to ${short(times.at(-1), 6)}.`);
    const place = this.nearest(axis, value);
    if (this.source instanceof EmbeddedSource && times[place] !== value) this.say(`This file has no t = ${value}; the nearest is shown.`);
    this.go(axis, place, this.source instanceof EmbeddedSource ? times[place] : value);
  }

  // The sliders, and under them which frames are there.
  marks() {
    const { resolution, preview, times } = this.meta;
    this.rows.forEach(({ play, range, ready, text }, axis) => {
      range.value = this.places[axis];
      if (document.activeElement !== text) text.value = short(this.values[axis], 6);
      const icon = this.playing && axis === this.axis ? PAUSE : PLAY;
      if (play.dataset.icon !== icon) play.innerHTML = play.dataset.icon = icon;
      [...ready.children].forEach((mark, i) => {
        const values = this.moved(axis, times[axis][i]);
        const name = this.panes.every((pane) => pane.has(resolution, values)) ? "fine" : this.panes.every((pane) => pane.has(preview, values)) ? "preview" : "";
        if (mark.className !== name) mark.className = name;
      });
    });
  }

  say(sentence) {
    $("message").textContent = sentence;
    $("message").hidden = false;
    clearTimeout(this.silence);
    this.silence = setTimeout(() => ($("message").hidden = true), 9000);
  }

  // Tools.

  tools() {
    const known = new Map(this.meta.viewed.flatMap((one) => one.quantities.map((quantity) => [quantity.name, quantity])));
    $("colour").append(make("option", { value: "", textContent: "clay" }), ...[...known.values()].map(({ name, label }) => make("option", { value: name, textContent: label })));
    $("colour").onchange = () => ((this.colour = $("colour").value), this.fit());
    $("fit").onclick = () => this.fit();
    $("ramp").style.background = `linear-gradient(to right, ${RAMP})`;
    this.unit = () => known.get(this.colour)?.unit ?? "";

    for (const button of $("axes").children) button.onclick = () => this.across(Number(button.dataset.axis));
    $("offset").oninput = () => this.across(this.cut.axis, Number($("offset").value));
    $("flip").onclick = () => this.across(this.cut.axis, this.cut.offset, -this.cut.side);
    $("contours").onchange = () => this.changed();
    const flat = this.panes.every((pane) => pane.flat);
    $("axes").hidden = flat;
    $("levels").hidden = !flat;
    $("spacing").textContent = this.spacings();

    $("measure").onclick = () => this.measure(!this.measuring);
    $("unmeasure").onclick = () => ((this.points = []), this.measure(false));
    $("reset").onclick = () => this.reset();
    $("up").onclick = () => {
      this.camera.up = this.camera.up === "y" ? "z" : "y";
      $("up").textContent = `${this.camera.up} up`;
      this.reset();
    };
    $("which").append(...this.meta.viewed.map((one, i) => make("option", { value: i, textContent: one.name })));
    $("which").hidden = this.panes.length < 2;
    for (const format of [...this.source.formats, "png"]) {
      const button = make("button", { type: "button", textContent: { usdc: "USD" }[format] ?? format.toUpperCase() });
      button.onclick = () => this.save(format, button);
      $("formats").append(button);
    }
  }

  reset() {
    this.framed = false;
    this.frame();
    this.redraw();
  }

  // The range of colours: that of the surfaces shown, with zero in the middle.
  fit() {
    const ranges = this.panes.map((pane) => pane.shown?.ranges[this.colour]).filter(Boolean);
    const most = Math.max(...ranges.flat().map(Math.abs), 0);
    this.range = [-most, most];
    this.ranged = this.colour;
    this.redraw();
  }

  colours() {
    if (this.colour && this.ranged !== this.colour) this.fit();
    $("legend").hidden = !this.colour;
    [$("low").textContent, $("high").textContent] = this.range.map((value) => short(value, 3).replace("-", "−"));
    $("unit").textContent = this.unit();
  }

  across(axis, offset = this.cut?.offset ?? 0, side = this.cut?.side ?? 1) {
    const normal = [0, 0, 0];
    if (axis >= 0) normal[axis] = side;
    this.cut = axis < 0 ? null : { axis, offset, side, half: [...normal, side * offset] };
    for (const button of $("axes").children) button.classList.toggle("on", Number(button.dataset.axis) === axis);
    $("cut").hidden = $("levels").hidden = axis < 0;
    $("offset").value = offset;
    const { center, scale } = this.meta.viewed[0];
    $("where").textContent = axis < 0 ? "" : `${"xyz"[axis]} = ${short(center[axis] + scale * offset)}`;
    this.changed();
  }

  spacings() {
    return `one every ${[...new Set(this.panes.map((pane) => short(this.spacing(pane))))].join(" and ")}`;
  }

  async save(format, button) {
    const pane = this.panes[Number($("which").value)], time = pane.time();
    const name = `${pane.meta.name.replace(/\.[^.]*$/, "")}${time.map((t) => `_t=${short(t, 6)}`).join("")}.${format}`;
    button.disabled = true;
    try {
      if (format === "png") this.draw({ resting: true });
      const blob = format === "png" ? await new Promise((resolve) => $("canvas").toBlob(resolve)) : await this.source.file(pane.number, time, format, pane.meta);
      const link = make("a", { href: URL.createObjectURL(blob), download: name });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    } catch (error) {
      this.say(error.message);
    }
    button.disabled = false;
  }

  // Distances.

  measure(on) {
    this.measuring = on;
    $("measure").classList.toggle("on", on);
    $("canvas").classList.toggle("measuring", on);
    this.redraw();
  }

  pick(x, y) {
    const pane = this.paneAt(x), shown = this.frameOf(pane);
    if (!shown?.position) return;
    const ray = this.camera.ray(x - pane.left, y, pane.width, $("stage").clientHeight);
    const half = pane.flat ? null : this.cut?.half;
    const found = meet(ray, shown.position, shown.index, (p) => !half || dot(half, p) <= half[3]);
    if (!found) return this.say("There is no surface under that point.");
    if (this.points.length === 2 || this.points[0]?.pane !== pane) this.points = [];
    this.points.push({ pane, point: found.point });
    if (this.points.length === 2) this.measure(false);
    this.redraw();
  }

  // The distance in the units of the file, written beside a line between the points.
  measured() {
    const [first, second] = this.points, height = $("stage").clientHeight;
    const places = this.points.map(({ pane, point }) => {
      const place = this.camera.project(point, pane.width, height);
      return place && [pane.left + place[0], place[1]];
    });
    let drawn = "";
    $("measured").textContent = this.measuring ? (first && !second ? "Click the other point." : "Click a point of the surface.") : "";
    if (second && places[0] && places[1]) {
      const [[x, y], [u, v]] = places, { scale } = second.pane.meta;
      const distance = short(scale * length(sub(second.point, first.point)), 5);
      const parts = sub(second.point, first.point).map((d) => short(Math.abs(scale * d), 3));
      $("measured").replaceChildren(make("strong", { textContent: distance }), ` (${parts.join(", ")})`);
      drawn = `<line x1="${x}" y1="${y}" x2="${u}" y2="${v}"/><text x="${(x + u) / 2 + 8}" y="${(y + v) / 2 - 8}">${distance}</text>`;
    }
    $("overlay").innerHTML = drawn + places.filter(Boolean).map(([x, y]) => `<circle cx="${x}" cy="${y}" r="4.5"/>`).join("");
  }

  // Pointer and keys.

  paneAt(x) {
    return this.panes[clamp(Math.floor(x / this.panes[0].width), 0, this.panes.length - 1)];
  }

  pointer() {
    const canvas = $("canvas"), down = new Map();
    const least = () => Math.min(this.panes[0].width, canvas.clientHeight);
    canvas.onpointerdown = (event) => {
      canvas.setPointerCapture(event.pointerId);
      if (this.editing?.press(event)) return;
      down.set(event.pointerId, { x: event.offsetX, y: event.offsetY, travelled: 0 });
      canvas.classList.add("held");
    };
    canvas.onpointermove = (event) => {
      if (this.editing?.drag(event)) return;
      const last = down.get(event.pointerId);
      if (!last) return;
      const [dx, dy] = [(event.offsetX - last.x) / least(), (event.offsetY - last.y) / least()];
      if (down.size === 2) {
        // Two fingers: half of the motion of each moves, and what they part comes closer.
        const [other] = [...down].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
        const apart = (p) => Math.hypot(p.x - other.x, p.y - other.y) || 1;
        this.camera.move(dx / 2, dy / 2);
        this.camera.zoom(apart(last) / apart({ x: event.offsetX, y: event.offsetY }));
      } else if (event.buttons & 6 || event.shiftKey || this.camera.flat) this.camera.move(dx, dy);
      else this.camera.turn(4 * dx, 4 * dy);
      Object.assign(last, { x: event.offsetX, y: event.offsetY, travelled: last.travelled + Math.abs(dx) + Math.abs(dy) });
      this.redraw();
    };
    canvas.onpointerup = canvas.onpointercancel = (event) => {
      if (this.editing?.lift()) return;
      const last = down.get(event.pointerId);
      down.delete(event.pointerId);
      if (!down.size) canvas.classList.remove("held");
      if (event.type !== "pointerup" || event.button !== 0 || !(last?.travelled < 0.01)) return;
      if (this.measuring) this.pick(event.offsetX, event.offsetY);
      else this.editing?.click(event.offsetX, event.offsetY);
    };
    canvas.oncontextmenu = (event) => event.preventDefault();
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        if (this.editing?.wheel(event)) return;
        this.camera.zoom(Math.exp(clamp(event.deltaY, -100, 100) / 400));
        this.redraw();
      },
      { passive: false },
    );
  }

  key(event) {
    if (this.editing?.key(event)) return event.preventDefault();
    if (event.target.matches("input[type=text], select") || event.ctrlKey || event.metaKey || event.altKey) return;
    const actions = {
      " ": () => this.play(),
      ArrowRight: () => this.step(1),
      ArrowLeft: () => this.step(-1),
      r: () => this.reset(),
      m: () => this.measure(!this.measuring),
      Escape: () => this.measure(false),
    };
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    // Arrows on a slider of its own are for it.
    if (!action || (["offset", "radius"].includes(event.target.id) && event.key.startsWith("Arrow"))) return;
    event.preventDefault();
    if (event.key.startsWith("Arrow") && this.playing) this.play();
    action();
  }
}

try {
  window.viewer = new Viewer();
} catch (error) {
  $("message").textContent = error.message;
  $("message").hidden = false;
}
