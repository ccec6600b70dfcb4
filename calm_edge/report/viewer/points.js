const RECORD = 12; // bytes of a point, see point_records.py

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}

const POINT_VERTEX = `
layout(location=0) in uvec4 upper;
layout(location=1) in uvec4 rest;
uniform mat4 clip; uniform vec3 low; uniform float stride; uniform float size; uniform int colors;
uniform vec2 heights; uniform highp sampler2D seconds; uniform float duration;
flat out vec3 color;
vec3 ramp(float t) {
  t = clamp(t, 0.0, 1.0) * 4.0;
  vec3 a = mix(vec3(.19,.07,.48), vec3(.16,.47,.90), clamp(t, 0., 1.));
  a = mix(a, vec3(.12,.76,.60), clamp(t - 1., 0., 1.));
  a = mix(a, vec3(.93,.81,.20), clamp(t - 2., 0., 1.));
  return mix(a, vec3(.90,.26,.15), clamp(t - 3., 0., 1.));
}
vec3 hue(float h) {
  return .25 + .7 * clamp(abs(fract(h + vec3(0., 2./3., 1./3.)) * 6. - 3.) - 1., 0., 1.);
}
void main() {
  uvec3 q = (upper.xyz << 2) | ((uvec3(rest.w) >> uvec3(0u, 2u, 4u)) & 3u);
  vec3 p = low + vec3(q) * stride;
  gl_Position = clip * vec4(p, 1.0);
  gl_PointSize = clamp(size / gl_Position.w, 1.0, 12.0);
  if (colors == 0) color = vec3(rest.xyz) / 255.0;
  else if (colors == 1) color = ramp((p.z - heights.x) / max(heights.y - heights.x, 1e-6));
  else if (colors == 2) color = hue(float(upper.w) * 0.61803399);
  else {
    int i = int(upper.w);
    color = ramp(texelFetch(seconds, ivec2(i & 255, i >> 8), 0).r / max(duration, 1e-6));
  }
}`;
const POINT_FRAGMENT = `
flat in vec3 color; out vec4 paint; void main() { paint = vec4(color, 1.0); }`;

/** The cloud: records in the order of the file, of which any prefix is a fair sample. */
class Points {
  constructor(gl, drive, most) {
    this.gl = gl;
    this.drive = drive;
    this.room = Math.min(drive.count, most);
    this.loaded = 0;
    this.records = new Uint8Array(this.room * RECORD); // kept to find the point that was clicked
    this.program = program(gl, POINT_VERTEX, POINT_FRAGMENT);
    this.at = Object.fromEntries(
      ["clip", "low", "stride", "size", "colors", "heights", "seconds", "duration"].map(
        (name) => [name, gl.getUniformLocation(this.program, name)]));
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    this.buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, this.room * RECORD, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 4, gl.UNSIGNED_SHORT, RECORD, 0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribIPointer(1, 4, gl.UNSIGNED_BYTE, RECORD, 8);
    gl.bindVertexArray(null);
    this.times = this.timeTexture(drive.submapSeconds);
  }

  timeTexture(seconds) {
    const gl = this.gl, rows = Math.max(1, Math.ceil(seconds.length / 256));
    const texels = new Float32Array(256 * rows);
    texels.set(seconds);
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, 256, rows, 0, gl.RED, gl.FLOAT, texels);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }

  /** Add the records of a base64 text, as far as there is room. */
  add(text) {
    const whole = Uint8Array.fromBase64 ? Uint8Array.fromBase64(text) : decoded(text);
    const bytes = whole.subarray(0, (this.room - this.loaded) * RECORD);
    const gl = this.gl, start = this.loaded * RECORD;
    this.records.set(bytes, start);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, start, bytes);
    this.loaded += bytes.length / RECORD;
  }

  /** Draw the points first..first + count. pixels: the size of one unit at distance 1. */
  draw(clip, pixels, colors, first, count) {
    const {gl, at, drive} = this;
    // fewer points than the map has are drawn larger, to close the surfaces
    const sparse = Math.min(2.5, Math.sqrt(drive.count / Math.max(1, this.loaded)));
    gl.useProgram(this.program);
    gl.bindVertexArray(this.array);
    gl.bindTexture(gl.TEXTURE_2D, this.times);
    gl.uniformMatrix4fv(at.clip, false, clip);
    gl.uniform3fv(at.low, drive.low);
    gl.uniform1f(at.stride, drive.step);
    gl.uniform1f(at.size, 1.2 * drive.grain * sparse * pixels);
    gl.uniform1i(at.colors, colors);
    gl.uniform2fv(at.heights, drive.heights);
    gl.uniform1f(at.duration, drive.seconds[drive.seconds.length - 1]);
    gl.drawArrays(gl.POINTS, first, count);
    gl.bindVertexArray(null);
  }

  /** The point nearest to (x, y) px of those within `reach` px that nothing hides, or null. */
  pick(clip, width, height, x, y, reach) {
    const upper = new Uint16Array(this.records.buffer), {low, step} = this.drive;
    const near = [];
    let depth = Infinity;
    for (let i = 0; i < this.loaded; i++) {
      const bits = this.records[i * RECORD + 11], p = [0, 0, 0];
      for (let a = 0; a < 3; a++) {
        p[a] = low[a] + ((upper[6 * i + a] << 2) | ((bits >> (2 * a)) & 3)) * step;
      }
      const w = clip[3] * p[0] + clip[7] * p[1] + clip[11] * p[2] + clip[15];
      if (w <= 0 || w > 1.05 * depth) continue;
      const s = onScreen(clip, width, height, p);
      const d = s ? Math.hypot(s[0] - x, s[1] - y) : Infinity;
      if (d > reach) continue;
      near.push([d, w, p]);
      depth = Math.min(depth, w);
    }
    const front = near.filter(([, w]) => w <= 1.05 * depth).sort((a, b) => a[0] - b[0]);
    return front.length ? front[0][2] : null;
  }
}

function decoded(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

/** Pixel of a point, or null if it is behind the eye or too near to it. */
function onScreen(m, width, height, p) {
  const [x, y, z, w] = [0, 1, 2, 3].map((i) => m[i] * p[0] + m[4 + i] * p[1] + m[8 + i] * p[2] + m[12 + i]);
  if (w <= 0 || z < -w) return null;
  return [(x / w + 1) / 2 * width, (1 - y / w) / 2 * height];
}
