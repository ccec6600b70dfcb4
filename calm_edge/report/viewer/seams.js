const SEAM_VERTEX = `
layout(location=0) in vec4 mark;
uniform mat4 clip; uniform float size; uniform float most;
out vec3 color;
void main() {
  gl_Position = clip * vec4(mark.xyz, 1.0);
  // in front of all points, as lines are
  gl_Position.z = -0.998 * gl_Position.w;
  gl_PointSize = size;
  float t = clamp(mark.w / most, 0.0, 1.0);
  color = t < 0.5 ? mix(vec3(.10,.60,.35), vec3(.95,.80,.15), 2.0 * t)
                  : mix(vec3(.95,.80,.15), vec3(.85,.15,.10), 2.0 * t - 1.0);
}`;
const SEAM_FRAGMENT = `
in vec3 color; out vec4 paint; void main() { paint = vec4(color, 1.0); }`;

/** Places of common anchors of two sub-maps, coloured by how far these disagree. */
class Seams {
  constructor(gl) {
    this.gl = gl;
    this.program = program(gl, SEAM_VERTEX, SEAM_FRAGMENT);
    this.at = Object.fromEntries(["clip", "size", "most"].map(
      (name) => [name, gl.getUniformLocation(this.program, name)]));
    this.array = gl.createVertexArray();
    this.count = 0;
    this.wanted = this.shown = false;
  }

  /** text: base64 of rows x, y, z, gap. median and most: of the gaps; most: 95 % of them. */
  set(text) {
    const gl = this.gl, marks = new Float32Array(decoded(text).buffer);
    const gaps = marks.filter((_, i) => i % 4 === 3).sort();
    this.count = gaps.length;
    [this.median, this.most] = [0.5, 0.95].map((q) => gaps[Math.floor(q * (gaps.length - 1))]);
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, marks, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 4, gl.FLOAT, false, 16, 0);
    gl.bindVertexArray(null);
  }

  /** size: px of a mark. */
  draw(clip, size) {
    if (!this.shown || !this.count) return;
    const {gl, at} = this;
    gl.useProgram(this.program);
    gl.bindVertexArray(this.array);
    gl.uniformMatrix4fv(at.clip, false, clip);
    gl.uniform1f(at.size, size);
    gl.uniform1f(at.most, Math.max(this.most, 1e-9));
    gl.drawArrays(gl.POINTS, 0, this.count);
    gl.bindVertexArray(null);
  }

  text(unit) {
    const [median, most] = [this.median, this.most].map((v) => v.toPrecision(2));
    return `Seams: where sub-maps overlap they disagree by ${median} ${unit} (median, green to yellow), `
      + `by more than ${most} ${unit} at the reddest.`;
  }
}
