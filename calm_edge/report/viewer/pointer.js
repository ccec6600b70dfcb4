/** Mouse, pen and fingers: one orbits (with shift or another button: pans), two pan and zoom. */
class Pointer {
  static CLICK_PX = 6;

  /** on: {orbit(dx, dy) rad, pan(dx, dy) share of the height, zoom(factor), click(x, y) px}. */
  constructor(canvas, on) {
    this.canvas = canvas;
    this.on = on;
    this.down = new Map();
    this.travelled = 0;
    canvas.addEventListener("pointerdown", (e) => this.press(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (e) => this.release(e));
    }
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      const lines = e.deltaMode === 1 ? 30 : 1;
      on.zoom(Math.exp(Math.max(-300, Math.min(300, e.deltaY * lines)) * 0.0012));
    }, {passive: false});
  }

  press(e) {
    try { this.canvas.setPointerCapture(e.pointerId); } catch { /* it has gone already */ }
    if (!this.down.size) this.travelled = 0;
    this.down.set(e.pointerId, [e.clientX, e.clientY]);
    if (this.down.size > 1) this.travelled = Infinity;
  }

  move(e) {
    const was = this.down.get(e.pointerId);
    if (!was) return;
    const before = [...this.down.values()];
    this.down.set(e.pointerId, [e.clientX, e.clientY]);
    const after = [...this.down.values()], height = this.canvas.clientHeight;
    const dx = e.clientX - was[0], dy = e.clientY - was[1];
    this.travelled += Math.hypot(dx, dy);
    if (this.travelled <= Pointer.CLICK_PX) return;
    if (before.length === 1) {
      if (e.shiftKey || (e.buttons & 6)) this.on.pan(dx / height, dy / height);
      else this.on.orbit(dx * 3 / height, dy * 3 / height);
    } else if (before.length === 2) {
      const span = (p) => Math.hypot(p[0][0] - p[1][0], p[0][1] - p[1][1]) || 1;
      this.on.pan(dx / 2 / height, dy / 2 / height);
      this.on.zoom(span(before) / span(after));
    }
  }

  release(e) {
    const clicked = this.down.has(e.pointerId) && this.travelled <= Pointer.CLICK_PX;
    this.down.delete(e.pointerId);
    if (clicked && e.type === "pointerup" && e.button === 0) {
      const box = this.canvas.getBoundingClientRect();
      this.on.click(e.clientX - box.left, e.clientY - box.top);
    }
  }
}
