// Handles placed and dragged on the surface, and the surface as they make it.

const KINDS = { move: [0.93, 0.53, 0.13], turn: [0.56, 0.36, 0.8], hold: [0.2, 0.48, 0.76] };
const AXES = ["#cf3f36", "#5c9b2e", "#2f6fc4"]; // of x, y and z
const NEAR = 12; // pixels around a marker that belong to it
const unit = (k) => [0, 1, 2].map((j) => Number(j === k));
const css = (rgb) => `rgb(${rgb.map((c) => Math.round(255 * c))})`;

class Editing {
  constructor(viewer) {
    const { handles, middles, ways } = (this.meta = viewer.meta.editing);
    this.pane = viewer.panes[0];
    Object.assign(this, { viewer, chosen: -1, kind: "move", side: "after", grab: null, after: null, error: "", warning: "", mouse: [0, 0] });
    this.radius = rounded([0.15 * this.pane.meta.scale], this.pane.meta)[0];
    this.list = handles.map((item, i) => Handle.opened(item, this.pane.meta, middles[i]));
    this.past = [this.state()];
    this.now = 0;
    this.saved = handles.length ? this.text() : "";
    this.live = Boolean(viewer.source.deformed);
    $("editing").hidden = $("command").hidden = false;
    $("way").append(...ways.map((way) => make("option", { value: way, textContent: { arap: "as rigid as possible", shell: "thin shell" }[way] ?? way })));
    $("showing").hidden = !this.live;
    this.buttons();
    this.shown();
    this.preview();
  }

  // Handles as they are in the file, and as they are changed here.

  text() {
    return JSON.stringify({ handles: this.list.map((handle) => handle.written()) });
  }

  state() {
    return JSON.stringify({ list: this.list, chosen: this.chosen });
  }

  get handle() {
    return this.list[this.chosen];
  }

  // What is seen: the surface after the edit where there is one, else that of the viewer.
  get frame() {
    return this.side === "after" && this.after && this.list.some((handle) => handle.moves) ? this.after : this.pane.shown;
  }

  // Colours on what the handles hold: for each vertex that of the nearest region, and how far it is.
  paint() {
    const { frame } = this;
    if (!frame?.mesh || (frame.coat === this.coat && frame.coat)) return;
    const rest = frame.rest ?? frame.position, tint = new Float32Array((4 * rest.length) / 3);
    const regions = this.list.map((handle, i) => {
      const dim = i === this.chosen ? 0 : 0.45;
      return { far: handle.distance(), colour: KINDS[handle.kind].map((c) => c + dim * (0.75 - c)), paint: "painted" in handle.region };
    });
    for (let i = 0; i < rest.length / 3; i++) {
      const p = [rest[3 * i], rest[3 * i + 1], rest[3 * i + 2]];
      let least = 1, colour = [0, 0, 0];
      regions.forEach((region, j) => {
        const d = region.paint ? (frame.held?.[i] === j + 1 ? -0.02 : 1) : region.far(p);
        if (d < least) [least, colour] = [d, region.colour];
      });
      tint.set(colour, 4 * i);
      tint[4 * i + 3] = least;
    }
    this.viewer.drawing.tint(frame.mesh, tint);
    frame.coat = this.coat ??= {};
  }

  repaint() {
    this.coat = null;
    this.viewer.redraw();
  }

  project(p) {
    const at = this.viewer.camera.project(p, this.pane.width, $("stage").clientHeight);
    return at && [this.pane.left + at[0], at[1]];
  }

  // Pixels in a length of the page, at a point.
  pixels(p) {
    const at = this.project(p), aside = this.project(add(p, this.viewer.camera.axes.right));
    return at && aside ? Math.hypot(aside[0] - at[0], aside[1] - at[1]) : 0;
  }

  // The point of the surface under the pointer, before the edit; in the plane the nearest of the curve.
  hit(x, y) {
    const { frame, pane, viewer } = this;
    if (!frame?.position) return null;
    const rest = frame.rest ?? frame.position, at = (points, i) => [points[3 * i], points[3 * i + 1], points[3 * i + 2]];
    if (pane.flat) {
      let least = NEAR, best = -1;
      for (let i = 0; i < rest.length / 3; i++) {
        const p = this.project(at(frame.position, i)), d = p ? Math.hypot(p[0] - x, p[1] - y) : Infinity;
        if (d < least) [least, best] = [d, i];
      }
      return best < 0 ? null : at(rest, best);
    }
    const ray = viewer.camera.ray(x - pane.left, y, pane.width, $("stage").clientHeight), half = viewer.cut?.half;
    const found = meet(ray, frame.position, frame.index, (p) => !half || dot(half, p) <= half[3]);
    if (!found) return null;
    const [a, b, c] = found.corners.map((i) => at(rest, i));
    return add(a, add(scaled(found.u, sub(b, a)), scaled(found.v, sub(c, a))));
  }

  // The handle whose marker or region is under the pointer, or -1; and the point of the surface there.
  under(x, y) {
    const away = this.list.map((handle, i) => {
      const at = this.project(toPage(handle.place, this.pane.meta));
      return [at ? Math.hypot(at[0] - x, at[1] - y) : Infinity, i];
    });
    const [marker] = away.filter(([d]) => d <= NEAR).sort(([a], [b]) => a - b);
    if (marker) return { number: marker[1] };
    const point = this.hit(x, y);
    const [region] = this.list.map((handle, i) => [point ? handle.distance()(point) : 1, i]).filter(([d]) => d <= 0).sort(([a], [b]) => a - b);
    return { number: region?.[1] ?? -1, point };
  }

  // The normal of the surface where a region is.
  normal(handle) {
    const { frame } = this, rest = frame.rest ?? frame.position, p = toPage(handle.middle, this.pane.meta);
    let least = Infinity, best = 0;
    for (let i = 0; i < rest.length / 3; i++) {
      const d = Math.hypot(rest[3 * i] - p[0], rest[3 * i + 1] - p[1], rest[3 * i + 2] - p[2]);
      if (d < least) [least, best] = [d, i];
    }
    return [0, 1, 2].map((k) => frame.normal[3 * best + k]);
  }

  // Pointer and keys. What is answered with true is not for the camera.

  press(event) {
    if (this.grab) return this.release(event.button === 0), true;
    if (event.button !== 0 || this.viewer.measuring || !this.list.length) return false;
    const { number } = this.under(event.offsetX, event.offsetY);
    if (number < 0) return false;
    this.choose(number);
    return !this.handle.held && this.begin(this.handle.kind, event.offsetX, event.offsetY);
  }

  begin(kind, x, y, modal = false) {
    const { handle } = this;
    if (!handle || !this.frame?.position) return false;
    const before = { kind: handle.kind, by: handle.by, angle: handle.angle, axis: handle.axis, scale: handle.scale };
    if (kind !== "scale") handle.kind = kind;
    const at = toPage(kind === "move" ? handle.place : handle.hub, this.pane.meta);
    this.grab = { kind, modal, x, y, at, last: [x, y], turned: 0, letter: -1, normal: null, before };
    $("canvas").classList.add("held");
    this.shown();
    return true;
  }

  drag(event) {
    const [x, y] = (this.mouse = [event.offsetX, event.offsetY]), { grab, handle, viewer } = this;
    if (!grab) {
      const at = this.handle && this.project(toPage(this.handle.place, this.pane.meta));
      $("canvas").classList.toggle("over", Boolean(at && Math.hypot(at[0] - x, at[1] - y) <= NEAR));
      return false;
    }
    const { camera } = viewer, { back } = camera.axes, { before, at } = grab, center = this.project(at);
    if (!center) return true;
    if (grab.kind === "move") {
      const axis = grab.letter >= 0 ? unit(grab.letter) : event.shiftKey ? (grab.normal ??= this.normal(handle)) : null;
      grab.axis = axis;
      handle.by = add(before.by, scaled(this.pane.meta.scale, axis ? this.along(axis, x, y) : sub(this.onPlane(x, y), this.onPlane(grab.x, grab.y))));
    } else if (grab.kind === "turn") {
      const way = ([u, v]) => Math.atan2(center[1] - v, u - center[0]), step = way([x, y]) - way(grab.last);
      grab.turned += step - 2 * Math.PI * Math.round(step / (2 * Math.PI));
      grab.last = [x, y];
      const axis = grab.letter >= 0 ? unit(grab.letter) : viewer.camera.flat ? [0, 0, 1] : back;
      const degrees = (Math.sign(dot(axis, back)) || 1) * ((180 * grab.turned) / Math.PI);
      [handle.axis, handle.angle] = composed([before.axis, before.angle], [axis, event.ctrlKey ? 5 * Math.round(degrees / 5) : degrees]);
    } else {
      const far = (u, v) => Math.hypot(u - center[0], v - center[1]) + 1;
      handle.scale = clamp((before.scale * far(x, y)) / far(grab.x, grab.y), 0.05, 20);
    }
    this.shown();
    this.preview({ quick: true });
    return true;
  }

  // Where the pointer is on the plane through the handle that faces the camera.
  onPlane(x, y) {
    const { camera } = this.viewer, { back } = camera.axes;
    const { start, way } = camera.ray(x - this.pane.left, y, this.pane.width, $("stage").clientHeight);
    return add(start, scaled(dot(back, sub(this.grab.at, start)) / dot(back, way), way));
  }

  // How far the pointer has gone along an axis, as it is seen.
  along(axis, x, y) {
    const { at } = this.grab, from = this.project(at), to = this.project(add(at, scaled(0.01, axis)));
    const seen = [100 * (to[0] - from[0]), 100 * (to[1] - from[1])], square = seen[0] ** 2 + seen[1] ** 2;
    // An axis that points at the eye cannot be pulled.
    return square < (0.02 * this.pixels(at)) ** 2 ? [0, 0, 0] : scaled(((x - this.grab.x) * seen[0] + (y - this.grab.y) * seen[1]) / square, axis);
  }

  release(keep) {
    const { grab } = this;
    if (!grab) return false;
    if (!keep) Object.assign(this.handle, grab.before);
    this.grab = null;
    $("canvas").classList.remove("held");
    this.changed();
    // The surface is still as it was dragged.
    if (!keep) this.preview();
    return true;
  }

  lift() {
    return this.grab && !this.grab.modal ? this.release(true) : false;
  }

  // A click on the bare surface places a handle, and one beside the surface chooses none.
  click(x, y) {
    const { number, point } = this.under(x, y);
    if (number >= 0 || !point) return this.choose(number);
    const region = { sphere: { center: toShape(point, this.pane.meta), radius: this.radius } };
    this.list.push(Handle.opened({ region }, this.pane.meta));
    this.list.at(-1).kind = this.kind;
    this.chosen = this.list.length - 1;
    this.changed();
  }

  wheel(event) {
    const { handle } = this, least = Math.min(this.pane.width, $("stage").clientHeight);
    if (!handle?.radius) return false;
    const at = toPage(handle.place, this.pane.meta), [u, v] = this.project(at) ?? [Infinity, Infinity];
    const reach = Math.max((handle.radius / this.pane.meta.scale) * this.pixels(at), NEAR);
    const over = Math.hypot(event.offsetX - u, event.offsetY - v) <= reach && reach < least / 3;
    if (!over && !this.grab && !event.ctrlKey) return false;
    this.resize(handle.radius * Math.exp(-clamp(event.deltaY, -100, 100) / 800));
    clearTimeout(this.resized);
    this.resized = setTimeout(() => this.grab || this.changed(), 300);
    return true;
  }

  resize(radius) {
    const { meta } = this.pane;
    this.radius = this.handle.radius = rounded([clamp(radius, 0.01 * meta.scale, 2 * meta.scale)], meta)[0];
    this.shown();
  }

  key(event) {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key, { grab, handle } = this;
    const control = event.ctrlKey || event.metaKey, typing = event.target.matches("input[type=text], select");
    if (event.altKey || (typing && !(control && key === "s"))) return false;
    if (control) {
      // What is being typed counts from when it is left.
      const actions = { z: () => this.go(event.shiftKey ? 1 : -1), y: () => this.go(1), s: () => (document.activeElement.blur(), this.save()) };
      return key in actions && !grab ? (actions[key](), true) : false;
    }
    if (grab) {
      if ("xyz".includes(key) && (key !== "z" || !this.pane.flat)) grab.letter = grab.letter === "xyz".indexOf(key) ? -1 : "xyz".indexOf(key);
      if (key === "Escape" || key === "Enter") this.release(key === "Enter");
      else this.drag({ offsetX: this.mouse[0], offsetY: this.mouse[1], shiftKey: event.shiftKey });
      return true;
    }
    // From a button, Tab goes to the next one.
    if (key === "Tab" && this.live && this.after && !event.target.closest("button, input")) return this.look(this.side === "after" ? "before" : "after"), true;
    if (!handle) return false;
    const actions = {
      g: () => this.begin("move", ...this.mouse, true),
      r: () => this.begin("turn", ...this.mouse, true),
      s: () => this.begin("scale", ...this.mouse, true),
      f: () => this.become(handle.held ? "move" : "hold"),
      Delete: () => this.remove(this.chosen),
      Backspace: () => this.remove(this.chosen),
      Escape: () => this.choose(-1),
    };
    return key in actions ? (actions[key](), true) : false;
  }

  // Changes.

  // Something is as it is meant to be: it can be undone, and what it does is shown.
  changed() {
    const state = this.state();
    if (JSON.stringify(JSON.parse(state).list) === JSON.stringify(JSON.parse(this.past[this.now]).list)) return this.shown();
    this.past.splice(this.now + 1, Infinity, state);
    this.now += 1;
    this.shown();
    this.preview();
  }

  go(by) {
    const state = this.past[this.now + by];
    if (!state) return;
    this.now += by;
    const { list, chosen } = JSON.parse(state);
    Object.assign(this, { list: list.map((parts) => new Handle(parts, this.pane.meta)), chosen });
    this.shown();
    this.preview();
  }

  choose(number) {
    this.chosen = number;
    if (number >= 0) this.kind = this.handle.kind;
    this.shown();
  }

  become(kind) {
    this.kind = kind;
    if (this.handle) this.handle.kind = kind;
    this.changed();
    this.shown();
  }

  remove(number) {
    this.list.splice(number, 1);
    this.chosen = Math.min(number, this.list.length - 1);
    this.changed();
  }

  look(side) {
    this.side = side;
    this.shown();
  }

  async save() {
    const text = this.text(), { file } = this.meta;
    try {
      if (!this.list.length) throw new Error("There are no handles; click the surface to place one.");
      if (this.viewer.source.save) await this.viewer.source.save(text);
      else {
        const link = make("a", { href: URL.createObjectURL(new Blob([`${JSON.stringify(JSON.parse(text), null, 1)}\n`], { type: "application/json" })), download: file });
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 10000);
      }
      this.saved = text;
      this.viewer.say(`${file} is saved.`);
    } catch (error) {
      this.viewer.say(plain(error.message));
    }
    this.shown();
  }

  // The surface after the edit: quick while something is dragged, exact when it rests. One is under way at a time; the
  // next is for how the handles are by then, and does not wait for an exact one.
  async preview({ quick = false } = {}) {
    if (!this.live) return;
    this.wanted = { quick };
    if (this.asking) return this.stop?.abort();
    this.asking = true;
    this.shown();
    while (this.wanted) {
      const { quick } = this.wanted;
      this.wanted = null;
      this.stop = quick ? null : new AbortController();
      try {
        this.adopt(this.list.length ? await this.ask(quick) : null);
      } catch (error) {
        if (error.name !== "AbortError" && !error.superseded) [this.error, this.warning] = [plain(error.message), ""];
      }
      this.shown();
    }
    this.asking = false;
    this.shown();
  }

  ask(quick) {
    const still = !this.list.some((handle) => handle.moves);
    const how = quick ? { steps: 1 } : still ? { steps: 1, way: $("way").value } : { way: $("way").value };
    return this.viewer.source.deformed(this.text(), how, this.stop?.signal);
  }

  adopt(frame) {
    const { center, scale, space } = this.pane.meta;
    if (this.after) this.viewer.drawing.forget(this.after.mesh);
    this.after = null;
    [this.error, this.warning] = ["", plain(frame?.note ?? "")];
    if (!frame) return;
    const { held, ...before } = frame.quantities, rest = new Float32Array(frame.position.length);
    for (let k = 0; k < space; k++) for (let i = 0; i < rest.length / 3; i++) rest[3 * i + k] = (before["xyz"[k]][i] - center[k]) / scale;
    this.after = { ...frame, quantities: {}, rest, held, mesh: this.viewer.drawing.upload({ ...frame, quantities: {} }, scale) };
  }

  // The list, the numbers and the words.

  buttons() {
    for (const button of $("kinds").children) button.onclick = () => this.become(button.dataset.kind);
    for (const button of $("sides").children) button.onclick = () => this.look(button.dataset.side);
    $("radius").oninput = () => this.handle && this.resize(this.pane.meta.scale * 10 ** Number($("radius").value));
    $("radius").onchange = () => this.changed();
    $("naming").onchange = () => this.handle && ((this.handle.name = $("naming").value.trim()), this.changed());
    $("numbers").onchange = () => this.type();
    $("way").onchange = () => (this.shown(), this.preview());
    $("undo").onclick = () => this.go(-1);
    $("redo").onclick = () => this.go(1);
    $("keep").onclick = () => this.save();
    $("try").onclick = () => (this.look("after"), this.preview());
    $("copy").onclick = () => navigator.clipboard?.writeText($("command").firstChild.textContent).then(() => this.viewer.say("Copied."));
    // Who turns to the tools has let go of what was dragged with a key.
    $("tools").addEventListener("pointerdown", () => this.release(true));
    addEventListener("beforeunload", (event) => this.unsaved && event.preventDefault());
  }

  get unsaved() {
    return this.text() !== this.saved && (this.list.length > 0 || this.saved !== "");
  }

  // Numbers that are typed: the vector of a motion, or an angle.
  type() {
    const { handle } = this, values = [...$("numbers").querySelectorAll("input")].map(({ value }) => (value.trim() === "" ? NaN : Number(value)));
    if (!handle || !values.every(Number.isFinite)) this.viewer.say("Type numbers, such as 0.25.");
    else if (handle.kind === "turn") handle.angle = values[0];
    else handle.by = pad(values);
    this.changed();
    this.shown();
  }

  shown() {
    const { handle, list, pane } = this, flat = pane.flat;
    $("handles").replaceChildren(
      ...list.map((one, i) => {
        const dot = make("i");
        dot.style.background = css(KINDS[one.kind]);
        const choose = make("button", { type: "button", className: "name" }, dot, `${one.name || i + 1} `, make("small", { textContent: one.words() }));
        const remove = make("button", { type: "button", textContent: "×", title: "Delete", ariaLabel: `delete handle ${i + 1}` });
        choose.onclick = () => this.choose(i);
        remove.onclick = () => this.remove(i);
        const wrong = new RegExp(`handle ${i + 1}\\b`, "i").test(this.error);
        return make("li", { className: `${i === this.chosen ? "on" : ""} ${wrong ? "wrong" : ""}` }, choose, remove);
      }),
    );
    for (const button of $("kinds").children) button.classList.toggle("on", button.dataset.kind === (handle?.kind ?? this.kind));
    for (const button of $("sides").children) button.classList.toggle("on", button.dataset.side === this.side);
    $("chosen").hidden = !handle;
    if (handle) {
      const radius = handle.radius;
      $("radius").parentElement.hidden = !radius;
      $("radius").value = Math.log10((radius ?? 1) / pane.meta.scale);
      $("size").textContent = short(radius ?? 0, 3);
      if (document.activeElement !== $("naming")) $("naming").value = handle.name;
      $("naming").placeholder = `handle ${this.chosen + 1}`;
      const shown = { hold: [], turn: [["angle °", handle.angle]], move: [..."xyz"].slice(0, flat ? 2 : 3).map((axis, k) => [axis, handle.by[k]]) }[handle.kind];
      if (!$("numbers").contains(document.activeElement) || this.grab)
        $("numbers").replaceChildren(...shown.map(([label, value]) => make("label", {}, label, make("input", { type: "text", inputMode: "decimal", value: short(value, 3), ariaLabel: `${handle.kind} ${label}` }))));
    }
    const wait = this.asking && !this.grab ? "computing …" : "";
    const hint = list.length ? "" : "Click the surface to place a handle.";
    $("note").textContent = this.error || wait || hint || this.warning;
    $("note").className = this.error ? "wrong" : "";
    $("undo").disabled = !this.now;
    $("redo").disabled = this.now === this.past.length - 1;
    $("keep").textContent = this.unsaved ? `Save ${this.meta.file} ●` : `Save ${this.meta.file}`;
    const way = $("way").value === this.meta.ways[0] ? "" : ` --rigid ${$("way").value}`;
    $("command").firstChild.textContent = this.meta.command + way;
    document.body.dataset.preview = this.asking ? "busy" : this.error ? "wrong" : "idle";
    this.repaint();
  }

  // Markers: where regions are, where they go, and what is being pulled.
  markers() {
    let drawn = "";
    this.list.forEach((handle, i) => {
      const chosen = i === this.chosen, [from, to] = [handle.middle, handle.place].map((p) => toPage(p, this.pane.meta));
      const [a, b] = [this.project(from), this.project(to)], colour = css(KINDS[handle.kind]);
      if (!a || !b) return;
      const radius = handle.radius / this.pane.meta.scale;
      if (chosen && radius) drawn += `<circle class="ball" cx="${b[0]}" cy="${b[1]}" r="${radius * handle.scale * this.pixels(to)}"/>`;
      if (handle.moves) drawn += `<line class="way" x1="${a[0]}" y1="${a[1]}" x2="${b[0]}" y2="${b[1]}"/><circle class="from" cx="${a[0]}" cy="${a[1]}" r="3"/>`;
      drawn += `<circle class="mark" cx="${b[0]}" cy="${b[1]}" r="${chosen ? 7 : 5}" fill="${colour}"/>`;
      if (chosen && this.grab) drawn += this.pulled(handle, b);
    });
    $("markers").innerHTML = drawn;
  }

  pulled(handle, [x, y]) {
    const { grab } = this, center = this.project(grab.at);
    const axis = grab.letter >= 0 ? unit(grab.letter) : grab.kind === "move" && grab.axis;
    let drawn = "";
    if (axis) {
      const [p, q] = [-3, 3].map((s) => this.project(add(grab.at, scaled(s, axis))));
      if (p && q) drawn += `<line x1="${p[0]}" y1="${p[1]}" x2="${q[0]}" y2="${q[1]}" stroke="${AXES[grab.letter] ?? "#6b655d"}"/>`;
    }
    if (grab.kind !== "move" && center) drawn += `<line class="way" x1="${center[0]}" y1="${center[1]}" x2="${this.mouse[0]}" y2="${this.mouse[1]}"/>`;
    const said = { move: () => short(length(sub(handle.by, grab.before.by)), 3), turn: () => `${short((180 * grab.turned) / Math.PI, 3)}°`, scale: () => `× ${short(handle.scale, 3)}` }[grab.kind]();
    return `${drawn}<text x="${x + 14}" y="${y - 12}">${said}</text>`;
  }
}

// A sentence of the library without the name of the function that says it.
function plain(sentence) {
  return sentence.replace(/^[\w.]+: (the text(, |: | ))?/, "").replace(/^./, (c) => c.toUpperCase());
}
