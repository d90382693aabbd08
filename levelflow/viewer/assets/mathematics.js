// Vectors of three numbers, the camera, and where a ray meets triangles.

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const scaled = (s, a) => [s * a[0], s * a[1], s * a[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (a) => Math.hypot(a[0], a[1], a[2]);
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

// A vector turned about an axis by an angle in degrees, counter-clockwise seen against the axis (Rodrigues).
function turned(a, axis, degrees) {
  const k = scaled(1 / length(axis), axis), c = Math.cos((degrees * Math.PI) / 180), s = Math.sin((degrees * Math.PI) / 180);
  return add(add(scaled(c, a), scaled(s, cross(k, a))), scaled((1 - c) * dot(k, a), k));
}

// Axis and angle of two turns, one after the other. About one axis angles add up, beyond a full turn as well.
function composed([a, first], [b, second]) {
  const [k, l] = [scaled(1 / length(a), a), scaled(1 / length(b), b)], along = dot(k, l);
  if (!first || Math.abs(along) > 1 - 1e-9) return [l, second + (first && Math.sign(along) * first)];
  // Quaternions: (w, v) (w', v') = (w w' - v.v', w v' + w' v + v x v').
  const half = Math.PI / 360, [p, u] = [Math.cos(second * half), scaled(Math.sin(second * half), l)];
  const [q, v] = [Math.cos(first * half), scaled(Math.sin(first * half), k)];
  const w = p * q - dot(u, v), n = add(add(scaled(p, v), scaled(q, u)), cross(u, v)), sine = length(n);
  if (sine < 1e-9) return [l, 0];
  const angle = Math.atan2(sine, w) / half;
  return [scaled(1 / sine, n), angle > 180 ? angle - 360 : angle];
}

// A pinhole camera that turns about its target. The shorter side of the picture spans the field of view.
class Camera {
  constructor(flat) {
    Object.assign(this, { flat, up: "y", target: [0, 0, 0], azimuth: 0, elevation: 0, distance: 6 });
  }

  // Looks from the front and a little from above, so that all points (x, y, z, x, y, z, ...) are in the picture.
  frame(clouds, width, height) {
    this.azimuth = this.flat ? 0 : Math.PI / 6;
    this.elevation = this.flat ? 0 : Math.PI / 12;
    const { right, up, back } = this.axes;
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const each = (visit) => {
      for (const points of clouds)
        for (let i = 0; i < points.length; i += 3) {
          const p = [points[i], points[i + 1], points[i + 2]];
          visit([dot(right, p), dot(up, p), dot(back, p)]);
        }
    };
    each((p) => p.forEach((c, k) => ((low[k] = Math.min(low[k], c)), (high[k] = Math.max(high[k], c)))));
    const middle = scaled(0.5, add(low, high)), least = Math.min(width, height);
    let distance = 0;
    each((p) => {
      const [x, y, z] = sub(p, middle);
      const sideways = Math.max((Math.abs(x) * least) / width, (Math.abs(y) * least) / height) / this.reach;
      distance = Math.max(distance, sideways + z);
    });
    this.target = add(add(scaled(middle[0], right), scaled(middle[1], up)), scaled(middle[2], back));
    this.distance = clamp(1.22 * distance, 0.05, 40);
  }

  get reach() {
    return Math.tan((25 * Math.PI) / 360);
  }

  // The unit vectors right, up and back (from the target to the eye).
  get axes() {
    const vertical = this.up === "y" ? [0, 1, 0] : [0, 0, 1];
    const front = this.up === "y" ? [0, 0, 1] : [0, -1, 0];
    const side = cross(vertical, front);
    const [ca, sa, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation), Math.sin(this.elevation)];
    const level = add(scaled(ca, front), scaled(sa, side));
    const back = add(scaled(ce, level), scaled(se, vertical));
    const right = sub(scaled(ca, side), scaled(sa, front));
    return { right, up: cross(back, right), back, vertical };
  }

  get eye() {
    return add(this.target, scaled(this.distance, this.axes.back));
  }

  // From points to clip coordinates, by columns: x_clip = P V x.
  matrix(width, height) {
    const { right, up, back } = this.axes;
    const eye = this.eye;
    const least = Math.min(width, height);
    const [fx, fy] = [least / width / this.reach, least / height / this.reach];
    const near = Math.max(this.distance - 8, this.distance * 0.01), far = this.distance + 8;
    const a = (near + far) / (near - far), b = (2 * near * far) / (near - far);
    const row = (axis, s) => [s * axis[0], s * axis[1], s * axis[2], -s * dot(axis, eye)];
    const x = row(right, fx), y = row(up, fy), z = row(back, 1);
    const m = new Float32Array(16);
    for (let j = 0; j < 4; j++) m.set([x[j], y[j], a * z[j] + (j === 3 ? b : 0), -z[j]], 4 * j);
    return m;
  }

  // The ray through a point of a picture, in pixels from its upper left corner.
  ray(px, py, width, height) {
    const { right, up, back } = this.axes;
    const s = (2 * this.reach) / Math.min(width, height);
    const way = add(add(scaled(s * (px - width / 2), right), scaled(s * (height / 2 - py), up)), scaled(-1, back));
    return { start: this.eye, way: scaled(1 / length(way), way) };
  }

  // Where a point lands in a picture, in pixels; null behind the eye.
  project(point, width, height) {
    const { right, up, back } = this.axes;
    const p = sub(point, this.eye);
    const depth = -dot(back, p);
    if (depth <= 0) return null;
    const s = Math.min(width, height) / 2 / this.reach / depth;
    return [width / 2 + s * dot(right, p), height / 2 - s * dot(up, p)];
  }

  turn(dx, dy) {
    this.azimuth -= dx;
    this.elevation = clamp(this.elevation + dy, -1.55, 1.55);
  }

  // By a share of the shorter side of the picture.
  move(dx, dy) {
    const { right, up } = this.axes;
    const s = 2 * this.reach * this.distance;
    this.target = add(this.target, add(scaled(-s * dx, right), scaled(s * dy, up)));
  }

  zoom(factor) {
    this.distance = clamp(this.distance * factor, 0.05, 40);
  }
}

// The nearest point at which a ray meets triangles and that `keep` accepts, with its triangle and its place there; or
// null (Möller and Trumbore, 1997): start + s way = (1 - u - v) a + u b + v c is solved for s, u and v by Cramer's rule.
function meet({ start, way }, positions, index, keep) {
  let nearest = Infinity, found = null;
  const corner = (i) => [positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]];
  for (let k = 0; k < index.length; k += 3) {
    const a = corner(index[k]), ab = sub(corner(index[k + 1]), a), ac = sub(corner(index[k + 2]), a);
    const p = cross(way, ac), det = dot(ab, p);
    if (det === 0) continue;
    const from = sub(start, a), u = dot(from, p) / det;
    if (u < 0 || u > 1) continue;
    const q = cross(from, ab), v = dot(way, q) / det;
    if (v < 0 || u + v > 1) continue;
    const s = dot(ac, q) / det;
    const point = add(start, scaled(s, way));
    if (s > 0 && s < nearest && keep(point)) [nearest, found] = [s, { point, corners: [index[k], index[k + 1], index[k + 2]], u, v }];
  }
  return found;
}

// A number of at most so many digits, without zeros at its end.
function short(x, digits = 4) {
  return Number.isFinite(x) ? String(Number(x.toPrecision(digits))) : "";
}

// 1, 2 or 5 times a power of ten, at least x.
function round125(x) {
  const power = 10 ** Math.floor(Math.log10(x));
  return [1, 2, 5, 10].map((m) => m * power).find((m) => m >= x * 0.999);
}
