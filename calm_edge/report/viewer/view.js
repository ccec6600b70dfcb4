/** Where the eye is: it looks at `target` from `away` units, at the angles yaw and pitch. */
class View {
  static FOV = 0.96; // vertical angle, rad

  constructor(target, yaw, pitch, away) {
    Object.assign(this, {target, yaw, pitch, away});
  }

  /** Unit vectors of the eye: forward, right and up. */
  axes() {
    const c = Math.cos(this.pitch);
    const forward = [-c * Math.cos(this.yaw), -c * Math.sin(this.yaw), -Math.sin(this.pitch)];
    const right = unit(cross(forward, [0, 0, 1]));
    return {forward, right, up: cross(right, forward)};
  }

  eye() { return add(this.target, this.axes().forward, -this.away); }

  /** Matrix from the world to clip coordinates. */
  matrix(aspect) {
    const {forward, right, up} = this.axes(), eye = this.eye();
    const near = this.away / 50, far = this.away * 200;
    const s = 1 / Math.tan(View.FOV / 2);
    const turn = [
      right[0], up[0], -forward[0], 0, right[1], up[1], -forward[1], 0,
      right[2], up[2], -forward[2], 0, -dot(right, eye), -dot(up, eye), dot(forward, eye), 1,
    ];
    const lens = [
      s / aspect, 0, 0, 0, 0, s, 0, 0, 0, 0, (near + far) / (near - far), -1,
      0, 0, 2 * near * far / (near - far), 0,
    ];
    return product(lens, turn);
  }

  orbit(dx, dy) {
    this.yaw = (this.yaw - dx) % (2 * Math.PI);
    this.pitch = Math.min(1.55, Math.max(-1.2, this.pitch + dy));
  }

  /** Shift the target by a share of the picture's height. */
  pan(dx, dy) {
    const {right, up} = this.axes(), k = 2 * this.away * Math.tan(View.FOV / 2);
    this.target = add(add(this.target, right, -dx * k), up, dy * k);
  }

  zoom(factor, least, most) { this.away = Math.min(most, Math.max(least, this.away * factor)); }

  /** Text for the address of the page. */
  toText() {
    return [...this.target, this.yaw, this.pitch, this.away].map((v) => v.toFixed(3)).join(",");
  }

  /** The view of such a text, or null if it is none. */
  static fromText(text) {
    const v = (text || "").split(",").map(Number);
    if (v.length !== 6 || !v.every(Number.isFinite) || v[5] <= 0) return null;
    return new View(v.slice(0, 3), v[3], v[4], v[5]);
  }
}
