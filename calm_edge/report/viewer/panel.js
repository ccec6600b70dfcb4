/** What stands around the map: buttons, the slider along the drive, pictures of a keyframe. */
class Panel {
  constructor(drive, on) {
    this.drive = drive;
    this.pictures = new Map();
    this.shown = null;
    this.element = Object.fromEntries(
      [...document.querySelectorAll("[id]")].map((e) => [e.id, e]));
    const {along, colors, measure, seams, share, whole, back, forth, hide, title} = this.element;
    title.textContent = drive.title;
    along.max = drive.path.length - 1;
    along.addEventListener("input", () => on.jump(Number(along.value)));
    back.addEventListener("click", () => on.jump(Math.max(0, Number(along.value) - 1)));
    forth.addEventListener("click", () => on.jump(Math.min(Number(along.max), Number(along.value) + 1)));
    colors.addEventListener("change", () => on.colors(colors.selectedIndex));
    measure.addEventListener("click", () => on.measure());
    seams.addEventListener("click", () => on.seams());
    share.addEventListener("click", () => this.copy());
    whole.addEventListener("click", () => on.whole());
    hide.addEventListener("click", () => this.show(null));
    this.fillEvents(on.jump);
    this.place(0);
  }

  /** List what was marked while driving; choosing one goes there. */
  fillEvents(jump) {
    const {events, marked} = this.element;
    for (const [k, text] of this.drive.events) {
      events.append(Object.assign(document.createElement("option"), {value: k, textContent: text}));
    }
    marked.hidden = !this.drive.events.length;
    events.addEventListener("change", () => { if (events.value !== "") jump(Number(events.value)); });
  }

  say(text) { this.element.status.textContent = text; }

  /** Put the slider on a keyframe. */
  place(k) {
    this.element.along.value = k;
    const here = this.drive.events.find(([row]) => row === k);
    this.element.events.value = here ? String(k) : "";
    // of a map of several drives: the time since the start of the drive
    const [name, first] = this.drive.drives.findLast(([, start]) => start <= k) || ["", 0];
    const t = this.drive.seconds[k] - this.drive.seconds[first];
    const own = name ? `, ${name}` : "";
    this.element.place.textContent =
      `keyframe ${k + 1} of ${this.drive.path.length}${own}, ${t.toFixed(1)} s`;
  }

  /** Show both cameras' pictures at keyframe k, or at the nearest that has some; null: hide them. */
  show(k) {
    this.shown = k;
    const {pictures, caption, primary, assistant} = this.element;
    const have = [...this.pictures.keys()];
    pictures.hidden = k === null || !have.length;
    if (pictures.hidden) return;
    const near = have.reduce((a, b) => (Math.abs(b - k) < Math.abs(a - k) ? b : a));
    const [one, two, later] = this.pictures.get(near);
    for (const [image, data] of [[primary, one], [assistant, two]]) {
      image.hidden = !data;
      if (data) image.src = "data:image/jpeg;base64," + data;
      else image.removeAttribute("src");
    }
    const ms = Math.round(1000 * later);
    const clock = !two ? "" : ms ? `; assistant ${Math.abs(ms)} ms ${ms > 0 ? "later" : "earlier"}` : "";
    const other = near === k ? "" : `, the nearest with pictures to ${k + 1}`;
    caption.textContent = `Keyframe ${near + 1}${other}${clock}`;
  }

  async copy() {
    try {
      await navigator.clipboard.writeText(location.href);
      this.say("The link to this view is copied.");
    } catch {
      window.prompt("The link to this view:", location.href);
    }
  }
}
