// A handle: a region of the surface that is moved, turned or held, as in the file (docs/handles.md). Regions and motions
// are in the units of the shape; what is drawn and picked is in those of the page.

const pad = (v) => [...v, 0, 0, 0].slice(0, 3);

class Handle {
  // Of what the file says, on what is viewed; the middle of a painted region is known to the server only.
  static opened({ name = "", region, freeze, move, rotate, scale = 1, center = null }, meta, middle = null) {
    const kind = freeze ? "hold" : rotate && !move ? "turn" : "move", axis = pad(rotate?.axis ?? [0, 0, 1]);
    return new Handle({ name, region, kind, by: pad(move ?? []), angle: rotate?.angle ?? 0, axis, scale, center, painted: middle }, meta);
  }

  constructor(parts, meta) {
    Object.assign(this, parts);
    Object.defineProperty(this, "meta", { value: meta });
  }

  written() {
    const { name, region, kind, by, angle, axis, scale, center } = this, item = { ...(name && { name }), region };
    if (kind === "hold") return { ...item, freeze: true };
    if (by.some(Boolean) || (!angle && scale === 1)) item.move = rounded(by, this.meta);
    if (angle) item.rotate = { ...(this.meta.space === 3 && { axis: scaled(1 / length(axis), axis).map((x) => Number(x.toFixed(6))) }), angle: Number(angle.toFixed(3)) };
    if (scale !== 1) item.scale = Number(scale.toPrecision(5));
    if (center && (angle || scale !== 1)) item.center = center;
    return item;
  }

  get held() {
    return this.kind === "hold";
  }

  get moves() {
    return !this.held && (this.by.some(Boolean) || this.angle !== 0 || this.scale !== 1);
  }

  // Of a ball, and of balls about several points; other regions have none.
  get radius() {
    return (this.region.sphere ?? this.region.points)?.radius;
  }

  set radius(radius) {
    const key = this.region.sphere ? "sphere" : "points";
    this.region = { [key]: { ...this.region[key], radius } };
  }

  get middle() {
    const { sphere, box, points } = this.region;
    if (sphere) return pad(sphere.center);
    if (box) return scaled(0.5, add(pad(box.lower), pad(box.upper)));
    return points ? scaled(1 / points.near.length, points.near.map(pad).reduce(add)) : pad(this.painted);
  }

  // The point about which the region turns, and the middle of the region, both where they are after the edit.
  get hub() {
    return add(pad(this.center ?? this.middle), this.held ? [0, 0, 0] : this.by);
  }

  get place() {
    return this.held ? this.middle : add(this.hub, scaled(this.scale, turned(sub(this.middle, pad(this.center ?? this.middle)), this.axis, this.angle)));
  }

  // How far a point is from the region, negative in it, all in units of the page. Who knows paint is the server.
  distance() {
    const { sphere, box, points } = this.region, { space, scale } = this.meta, at = (p) => toPage(p, this.meta);
    if (box) {
      const lower = at(box.lower), upper = at(box.upper), middle = scaled(0.5, add(lower, upper));
      const half = sub(upper, middle).map((h, k) => (k < space ? h : Infinity));
      return (p) => {
        const q = sub(p, middle).map((x, k) => Math.abs(x) - half[k]), most = Math.max(...q);
        return most > 0 ? length(q.map((x) => Math.max(x, 0))) : most;
      };
    }
    if (!sphere && !points) return () => Infinity;
    const near = (points?.near ?? [sphere.center]).map(at), radius = this.radius / scale;
    return (p) => Math.min(...near.map((c) => length(sub(p, c)))) - radius;
  }

  words() {
    const { kind, by, angle, scale, region } = this, parts = region.sphere ? [] : [Object.keys(region)[0]];
    if (kind === "hold") return ["hold", ...parts].join(", ");
    if (kind === "move" || by.some(Boolean)) parts.push(`move ${short(length(by), 3)}`);
    if (kind === "turn" || angle) parts.push(`turn ${short(angle, 3)}°`);
    if (scale !== 1) parts.push(`× ${short(scale, 3)}`);
    return parts.join(", ");
  }
}

function toPage(p, { center, scale, space }) {
  return scaled(1 / scale, sub(pad(p), center)).map((c, k) => (k < space ? c : 0));
}

function toShape(p, meta) {
  return rounded(add(meta.center, scaled(meta.scale, p)), meta);
}

// As many digits as a hundred thousandth of the shape needs, and as many coordinates as it has.
function rounded(v, { scale, space }) {
  const step = 10 ** (Math.floor(Math.log10(scale)) - 5);
  return v.slice(0, space).map((x) => Number((Math.round(x / step) * step).toPrecision(12)));
}
