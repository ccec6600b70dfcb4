const LINE_VERTEX = `
layout(location=0) in vec3 a;
layout(location=1) in vec3 b;
uniform mat4 clip; uniform vec2 picture; uniform float width;
void main() {
  vec4 p = clip * vec4(a, 1.0), q = clip * vec4(b, 1.0);
  // cut at the near plane, behind which the direction on the screen is wrong
  float dp = p.z + p.w, dq = q.z + q.w;
  if (dp < 0.0 && dq > 0.0) p = mix(p, q, dp / (dp - dq) + 1e-4);
  else if (dq < 0.0 && dp > 0.0) q = mix(q, p, dq / (dq - dp) + 1e-4);
  vec2 along = (q.xy / q.w - p.xy / p.w) * picture;
  along = dot(along, along) > 1e-6 ? normalize(along) : vec2(1.0, 0.0);
  vec2 across = vec2(-along.y, along.x);
  bool end = (gl_VertexID & 1) == 1;
  vec4 c = end ? q : p;
  vec2 offset = across * ((gl_VertexID & 2) == 2 ? 1.0 : -1.0) + along * (end ? 1.0 : -1.0);
  gl_Position = c + vec4(offset * width / picture * c.w, 0.0, 0.0);
  // in front of all points: the drive is never hidden, and points drawn later do not cover it
  if (dp > 0.0 || dq > 0.0) gl_Position.z = -0.999 * gl_Position.w;
}`;
const LINE_FRAGMENT = `
uniform vec3 ink; out vec4 paint; void main() { paint = vec4(ink, 1.0); }`;

/** Line segments of a stated width in px, before all points. */
class Lines {
  constructor(gl) {
    this.gl = gl;
    this.program = program(gl, LINE_VERTEX, LINE_FRAGMENT);
    this.at = Object.fromEntries(["clip", "picture", "width", "ink"].map(
      (name) => [name, gl.getUniformLocation(this.program, name)]));
    this.array = gl.createVertexArray();
    this.buffer = gl.createBuffer();
    this.count = 0;
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    for (const end of [0, 1]) {
      gl.enableVertexAttribArray(end);
      gl.vertexAttribPointer(end, 3, gl.FLOAT, false, 24, 12 * end);
      gl.vertexAttribDivisor(end, 1);
    }
    gl.bindVertexArray(null);
  }

  /** Replace the segments. pairs: [a, b] each; a point is a segment of no length. */
  set(pairs) {
    this.count = pairs.length;
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.buffer);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, new Float32Array(pairs.flat(2)), this.gl.DYNAMIC_DRAW);
  }

  /** ink: RGB, 0 to 1. width: px. */
  draw(clip, picture, ink, width) {
    if (!this.count) return;
    const {gl, at} = this;
    gl.useProgram(this.program);
    gl.bindVertexArray(this.array);
    gl.uniformMatrix4fv(at.clip, false, clip);
    gl.uniform2fv(at.picture, picture);
    gl.uniform1f(at.width, width);
    gl.uniform3fv(at.ink, ink);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
    gl.bindVertexArray(null);
  }
}
