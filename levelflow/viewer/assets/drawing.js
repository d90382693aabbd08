// Drawing with WebGL 2: matt clay in soft light, colours of a quantity, the cut, and the level sets on it.

// The light of levelflow/rendering/shading.py: a key light over the left shoulder, a fill, sky and floor, darker hollows.
// It falls on vertices, of which there are plenty, so that pixels are cheap where a processor draws them.
const VERTEX = `#version 300 es
precision highp float;
uniform mat4 camera;
uniform vec3 right, up, back, eye, vertical;
uniform float colours;  // 1 to show the quantity, 0 for clay
uniform float flatness; // 1 for a curve in the plane, which has no light
uniform vec2 range;     // what is added to a value, and by what it is then divided, to lie in [-1, 1]
uniform vec3 ramp[5];
in vec3 position, normal;
in float quantity, curvature;
in vec4 tint;           // the colour of the nearest handle, and how far its region is
out vec3 at, outside, inside;
out vec4 held;
vec3 linear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
vec3 srgb(vec3 c) { return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)); }
vec3 ramped(float v) {
  float s = clamp(2.0 * v + 2.0, 0.0, 4.0);
  int i = min(int(s), 3);
  return mix(ramp[i], ramp[i + 1], s - float(i));
}
vec3 lit(vec3 albedo, vec3 n, vec3 towards, float openness) {
  vec3 m = n * mat3(right, up, back);  // in the frame of the camera
  vec3 key = normalize(vec3(-0.60, 0.70, 0.50));
  float sky = 0.5 + 0.5 * dot(n, vertical), facing = clamp(dot(m, towards), 0.0, 1.0);
  vec3 light = max(dot(m, key), 0.0) * vec3(0.90, 0.85, 0.78) + max(dot(m, normalize(vec3(0.85, 0.05, 0.5))), 0.0) * vec3(0.13, 0.14, 0.16);
  light = light * (0.4 + 0.6 * openness) + mix(vec3(0.19, 0.155, 0.135), vec3(0.36, 0.39, 0.44), sky) * openness;
  float gloss = 0.06 * pow(max(dot(m, normalize(key + towards)), 0.0), 30.0) * openness;
  vec3 rim = 0.10 * pow(1.0 - facing, 4.0) * vec3(0.36, 0.39, 0.44) * (0.3 + sky);
  return srgb(clamp(albedo * light + gloss + rim, 0.0, 1.0));
}
void main() {
  vec3 albedo = linear(colours > 0.5 ? ramped((quantity + range.x) / range.y) : vec3(0.88, 0.70, 0.58));
  vec3 towards = normalize((eye - position) * mat3(right, up, back));
  at = position;
  held = tint;
  outside = flatness > 0.5 ? srgb(colours > 0.5 ? albedo : 0.3 * albedo) : lit(albedo, normal, towards, exp(0.045 * curvature));
  inside = flatness > 0.5 ? outside : lit(linear(vec3(0.36, 0.50, 0.62)), -normal, towards, 1.0);
  gl_Position = camera * vec4(position, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 cut;  // an axis with its side as a sign, and the offset: what lies beyond is not drawn
in vec3 at, outside, inside;
in vec4 held;
out vec4 result;
void main() {
  if (dot(cut.xyz, at) > cut.w) discard;
  vec3 colour = gl_FrontFacing ? outside : inside;
  float edge = fwidth(held.w) + 1e-6, region = clamp(0.5 - held.w / edge, 0.0, 1.0);
  float rim = 1.0 - smoothstep(0.5, 1.8, abs(held.w) / edge);
  float light = dot(colour, vec3(0.36, 0.36, 0.36));
  colour = mix(colour, 0.2 * colour + 1.15 * held.rgb * light, 0.9 * region);
  result = vec4(mix(colour, 0.7 * held.rgb, 0.8 * rim), 1.0);
}`;

const PLANE_VERTEX = `#version 300 es
uniform mat4 camera;
uniform int axis;
uniform float offset;
in vec2 corner;
out vec3 at;
out vec2 place;
void main() {
  at[axis] = offset;
  at[(axis + 1) % 3] = corner.x;
  at[(axis + 2) % 3] = corner.y;
  place = corner;
  gl_Position = camera * vec4(at, 1.0);
}`;

// Level sets c = k * spacing: the distance to the nearest in pixels is |f - c| divided by the change of f over a pixel.
const PLANE_FRAGMENT = `#version 300 es
precision highp float;
uniform highp sampler2D values;
uniform vec3 lower, upper;
uniform float spacing, pixels;  // pixels of the picture in a pixel of the page
in vec3 at;
in vec2 place;
out vec4 result;
float value(vec2 p) {
  vec2 n = vec2(textureSize(values, 0)), s = clamp((p + 1.0) / 2.0, 0.0, 1.0) * (n - 1.0);
  ivec2 i = ivec2(min(floor(s), n - 2.0));
  vec2 w = s - vec2(i);
  return mix(mix(texelFetch(values, i, 0).r, texelFetch(values, i + ivec2(1, 0), 0).r, w.x),
             mix(texelFetch(values, i + ivec2(0, 1), 0).r, texelFetch(values, i + ivec2(1, 1), 0).r, w.x), w.y);
}
void main() {
  float f = value(place), pixel = pixels * fwidth(f) + 1e-9;
  if (any(lessThan(at, lower - 2e-3)) || any(greaterThan(at, upper + 2e-3))) discard;
  float level = f / spacing, k = round(level);
  float line = 1.0 - smoothstep(0.4, 1.3, abs(level - k) * spacing / pixel);
  float zero = 1.0 - smoothstep(1.0, 2.2, abs(f) / pixel);
  float crowd = clamp(spacing / pixel / 4.0, 0.0, 1.0);  // no lines where they would touch each other
  bool inside = f < 0.0;
  vec4 ground = inside ? vec4(0.93, 0.86, 0.80, 1.0) : vec4(0.80, 0.85, 0.89, 0.30);
  vec3 ink = inside ? vec3(0.62, 0.36, 0.22) : vec3(0.35, 0.45, 0.54);
  result = mix(ground, vec4(ink, inside ? 1.0 : 0.75), 0.75 * line * crowd);
  result = mix(result, vec4(0.20, 0.16, 0.14, 1.0), zero);
  result.rgb *= result.a;
}`;

// Whether pictures are made by the processor, for want of a graphics card.
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const told = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl?.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : gl.RENDERER) ?? "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software/i.test(name);
}

const RAMP = ["#2c5f8a", "#8fb8cf", "#f1ece4", "#e2a077", "#a33b20"];

class Drawing {
  constructor(canvas) {
    this.canvas = canvas;
    // Where a processor draws, edges are smooth only in the picture that follows when all is at rest, drawn larger.
    this.software = isSoftware();
    const gl = (this.gl = canvas.getContext("webgl2", { antialias: !this.software, alpha: false, preserveDrawingBuffer: true }));
    if (!gl) throw new Error("This page draws with WebGL 2, which this browser does not offer; turn on hardware acceleration, or use another browser.");
    this.surface = this.program(VERTEX, FRAGMENT, ["position", "normal", "quantity", "curvature", "tint"]);
    this.plane = this.program(PLANE_VERTEX, PLANE_FRAGMENT, ["corner"]);
    this.square = gl.createVertexArray();
    gl.bindVertexArray(this.square);
    this.attribute(0, 2, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]));
    gl.vertexAttrib4f(4, 0, 0, 0, 1); // no handle is near
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.ramp = new Float32Array(RAMP.flatMap((c) => [1, 3, 5].map((i) => parseInt(c.slice(i, i + 2), 16) / 255)));
  }

  program(vertex, fragment, attributes) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    attributes.forEach((name, i) => gl.bindAttribLocation(program, i, name));
    gl.linkProgram(program);
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniforms[name.replace("[0]", "")] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
  }

  attribute(place, width, data) {
    const gl = this.gl, buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, width, gl.FLOAT, false, 0, 0);
    return buffer;
  }

  // A frame on the graphics card: one set of arrays, and a buffer for each quantity.
  upload(frame, scale) {
    const gl = this.gl, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = [this.attribute(0, 3, frame.position), this.attribute(1, 3, frame.normal)];
    // Hollows have negative curvature, in units of the page.
    const kappa = frame.quantities.curvature;
    if (kappa) buffers.push(this.attribute(3, 1, kappa.map((k) => clamp(k * scale, -30, 0))));
    const quantities = {};
    for (const [name, values] of Object.entries(frame.quantities)) buffers.push((quantities[name] = this.attribute(2, 1, values)));
    gl.disableVertexAttribArray(2);
    const index = gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, index);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, frame.index, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    return { array, quantities, buffers: [...buffers, index], count: frame.index.length };
  }

  // Four numbers for each vertex: the colour of what holds it, and how far that is, negative in it.
  tint(mesh, values) {
    const gl = this.gl;
    gl.bindVertexArray(mesh.array);
    if (!mesh.tint) mesh.buffers.push((mesh.tint = this.attribute(4, 4, values)));
    else {
      gl.bindBuffer(gl.ARRAY_BUFFER, mesh.tint);
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
    }
    gl.bindVertexArray(null);
  }

  forget({ array, buffers }) {
    for (const buffer of buffers) this.gl.deleteBuffer(buffer);
    this.gl.deleteVertexArray(array);
  }

  // Values on a plane as a texture.
  texture(values, n) {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, n, n, 0, gl.RED, gl.FLOAT, values);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    return texture;
  }

  // Waits until the picture is there: a pixel can only be read then.
  finish() {
    this.gl.readPixels(0, 0, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  // One picture for each pane: { left, width (pixels of the page), mesh, flat, plane, spacing, lower, upper }.
  draw(panes, camera, { quantity, range, cut, resting }) {
    const gl = this.gl, { canvas } = this, ratio = (window.devicePixelRatio || 1) * (this.software && resting ? 2 : 1);
    const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0.985, 0.98, 0.97, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.SCISSOR_TEST);
    const { right, up, back, vertical } = camera.axes;
    for (const pane of panes) {
      const box = [Math.round(pane.left * ratio), 0, Math.round(pane.width * ratio), height];
      gl.viewport(...box);
      gl.scissor(...box);
      const matrix = camera.matrix(box[2], box[3]);
      if (pane.mesh) {
        const { program, uniforms } = this.surface, values = pane.mesh.quantities[quantity];
        gl.useProgram(program);
        gl.uniformMatrix4fv(uniforms.camera, false, matrix);
        for (const [name, axis] of Object.entries({ right, up, back, vertical, eye: camera.eye })) gl.uniform3fv(uniforms[name], axis);
        gl.uniform4fv(uniforms.cut, cut && !pane.flat ? cut.half : [0, 0, 0, 1]);
        gl.uniform1f(uniforms.colours, values ? 1 : 0);
        gl.uniform1f(uniforms.flatness, pane.flat ? 1 : 0);
        gl.uniform2fv(uniforms.range, values ? [-(range[0] + range[1]) / 2, (range[1] - range[0]) / 2 || 1] : [0, 1]);
        gl.uniform3fv(uniforms.ramp, this.ramp);
        gl.bindVertexArray(pane.mesh.array);
        if (values) {
          gl.bindBuffer(gl.ARRAY_BUFFER, values);
          gl.enableVertexAttribArray(2);
          gl.vertexAttribPointer(2, 1, gl.FLOAT, false, 0, 0);
        } else gl.disableVertexAttribArray(2);
        gl.drawElements(gl.TRIANGLES, pane.mesh.count, gl.UNSIGNED_INT, 0);
      }
      if (pane.plane) {
        const { program, uniforms } = this.plane;
        gl.useProgram(program);
        gl.uniformMatrix4fv(uniforms.camera, false, matrix);
        gl.uniform1i(uniforms.axis, pane.plane.axis);
        gl.uniform1f(uniforms.offset, pane.plane.offset);
        gl.uniform3fv(uniforms.lower, pane.lower);
        gl.uniform3fv(uniforms.upper, pane.upper);
        gl.uniform1f(uniforms.spacing, pane.spacing);
        gl.uniform1f(uniforms.pixels, ratio);
        gl.bindTexture(gl.TEXTURE_2D, pane.plane.texture);
        gl.bindVertexArray(this.square);
        gl.enable(gl.BLEND);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
        gl.disable(gl.BLEND);
      }
    }
    gl.bindVertexArray(null);
  }
}
