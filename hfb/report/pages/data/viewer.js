// The viewer: a time line over sub-frames, play, ghosts, colours, and turning by mouse, touch and keys.
"use strict";

hfb.groups = {};

hfb.Viewer = class {
  constructor(root, scene) {
    this.root = root;
    this.motions = scene.motions.map((packed) => new hfb.Motion(packed, scene.parents));
    this.motion = this.motions[0];
    this.position = 0;
    this.playing = false;
    this.looked = false;
    this.group = scene.group === null ? null : (hfb.groups[scene.group] = hfb.groups[scene.group] || []);
    if (this.group) this.group.push(this);
    this.view = this.group && this.group[0].view ? this.group[0].view : new hfb.View(this._reach());
    this._build(scene);
    this._listen();
    this.choose(Math.floor((this.motion.rowsOfFrame(0)[1] - 1) / 2));
  }

  // The radius [m] of a ball around what the view looks at that holds the body, and its path while the view stands.
  _reach() {
    const rest = this.motion.rest, low = [Infinity, Infinity, Infinity], high = low.map((value) => -value);
    for (let at = 0; at < 72; at++) {
      low[at % 3] = Math.min(low[at % 3], rest[at]);
      high[at % 3] = Math.max(high[at % 3], rest[at]);
    }
    let path = 0;
    for (let row = 0; row < this.motion.rows; row++) {
      let apart = 0;
      for (let k = 0; k < 3; k++) {
        apart += (this.motion.places[3 * row + k] + rest[k] - this.motion.targets[3 * row + k]) ** 2;
      }
      path = Math.max(path, Math.sqrt(apart));
    }
    return 0.62 * (high[1] - low[1]) + Math.min(path, 1);
  }

  _build(scene) {
    const make = (tag, parent, text = "", name = "") => {
      const made = parent.appendChild(document.createElement(tag));
      if (text) made.textContent = text;
      if (name) made.className = name;
      return made;
    };
    this.root.querySelector(".fallback")?.remove();
    const stage = make("div", this.root, "", "stage");
    this.canvas = make("canvas", stage);
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "the body in 3D; drag or use the arrow keys to look from another side");
    if (scene.label) make("div", stage, scene.label, "label");
    this.legend = make("div", stage, "", "legend");
    const redraw = () => this.draw();
    try {
      if (!scene.skin) throw new Error("no body model");
      this.drawing = new hfb.Surface(this.canvas, scene.skin, scene.texture, redraw);
    } catch {
      const fresh = this.canvas.cloneNode(); // a canvas that was asked for WebGL has no pen any more
      this.canvas.replaceWith(fresh);
      this.canvas = fresh;
      this.drawing = new hfb.Skeleton(fresh);
    }
    this.root.dataset.drawing = this.drawing.kind;
    const bar = make("div", this.root, "", "bar");
    this.playButton = make("button", bar, "\u25b6 Play", "play");
    this.slider = make("input", bar, "", "when");
    Object.assign(this.slider, { type: "range", min: 0, max: this.motion.rows - 1, step: 1 });
    this.slider.setAttribute("aria-label", "sub-frame");
    this.clock = make("output", bar, "", "clock");
    if (this.motions.length > 1) {
      this.menu = make("select", make("label", bar, "Motion "), "", "motions");
      this.motions.forEach((motion, number) => { make("option", this.menu, motion.name).value = number; });
    }
    this.colours = make("select", make("label", bar, "Colour "), "", "colours");
    const kinds = [["person", "the person's"], ["time", "time"]];
    if (this.drawing.kind === "skeleton" || !scene.texture) kinds.shift();
    if (this.motions.some((motion) => motion.radius)) kinds.push(["sureness", "how sure"]);
    for (const [value, text] of kinds) make("option", this.colours, text).value = value;
    const ghosts = make("label", bar);
    this.ghosts = make("input", ghosts, "", "ghosts");
    Object.assign(this.ghosts, { type: "checkbox", checked: true });
    ghosts.append("ghosts of the exposure");
    this.sides = [["front", 0, 0], ["side", Math.PI / 2, 0], ["above", 0, 1.2]].map(([name, yaw, tilt]) => {
      const button = make("button", bar, name, "side");
      button.onclick = () => this._look(yaw - this.view.yaw, tilt - this.view.tilt);
      return button;
    });
  }

  _listen() {
    this.slider.oninput = () => { this.pause(); this.choose(Number(this.slider.value)); };
    this.playButton.onclick = () => (this.playing ? this.pause() : this.play());
    this.colours.onchange = this.ghosts.onchange = () => this.draw();
    if (this.menu) {
      this.menu.onchange = () => {
        this.motion = this.motions[Number(this.menu.value)];
        this.choose(Math.min(this.position, this.motion.rows - 1));
      };
    }
    const fingers = new Map();
    this.canvas.onpointerdown = (event) => {
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      this.canvas.setPointerCapture(event.pointerId);
    };
    this.canvas.onpointerup = this.canvas.onpointercancel = (event) => fingers.delete(event.pointerId);
    this.canvas.onpointermove = (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = [event.clientX, event.clientY];
      if (fingers.size === 1) {
        this._look(0.008 * (now[0] - before[0]), 0.008 * (now[1] - before[1]));
      } else {
        const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
        const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]);
        this._zoom(apart(now) / Math.max(apart(before), 1));
      }
      fingers.set(event.pointerId, now);
    };
    this.canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== this.canvas) return; // else the page scrolls
      event.preventDefault();
      this._zoom(Math.exp(-0.001 * event.deltaY));
    }, { passive: false });
    this.canvas.onkeydown = (event) => {
      const turns = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, -0.15], ArrowDown: [0, 0.15] };
      const scales = { "+": 1.1, "-": 1 / 1.1 };
      if (turns[event.key]) this._look(...turns[event.key]);
      else if (scales[event.key]) this._zoom(scales[event.key]);
      else if (event.key === " ") this.playButton.click();
      else return;
      event.preventDefault();
    };
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  members() { return this.group || [this]; }

  // A row of the table, which may lie between two; everyone in the group goes to the same instant.
  choose(position) {
    const time = this.motion.timeAt(position);
    for (const one of this.members()) one._show(one === this ? position : one.motion.at(time));
  }

  setTime(time) { this.choose(this.motion.at(time)); }

  play() {
    this.playing = true;
    this.playButton.textContent = "\u275a\u275a Pause";
    if (this.position >= this.motion.rows - 1) this.choose(0);
    let before = null;
    const step = (now) => {
      if (!this.playing) return;
      if (before !== null) this._advance(Math.min(now - before, 100) / 1000 / this.slow());
      before = now;
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  pause() {
    this.playing = false;
    this.playButton.textContent = "\u25b6 Play";
  }

  // How many times slower than it was: the sub-frames of an exposure in half a second, nothing in less than two.
  slow() {
    const [start, stop] = this.motion.rowsOfFrame(0);
    const exposure = this.motion.times[stop - 1] - this.motion.times[start];
    const lasts = this.motion.last() - this.motion.first();
    return Math.max(1, 0.5 / Math.max(exposure, 1e-9), 2 / Math.max(lasts, 1e-9));
  }

  _advance(seconds) {
    const { motion } = this, row = Math.floor(this.position);
    if (this.position >= motion.rows - 1) return this.choose(0);
    if (motion.absentAfter(row)) return this.choose(row + 1);
    const next = motion.timeAt(this.position) + seconds;
    const reached = motion.at(next);
    return this.choose(reached > this.position ? reached : Math.min(row + 1, motion.rows - 1));
  }

  _show(position) {
    this.position = position;
    this.slider.max = this.motion.rows - 1;
    this.slider.value = Math.round(position);
    this.draw();
  }

  _look(yaw, tilt) {
    this.view.yaw += yaw;
    this.view.tilt = Math.min(1.5, Math.max(-1.5, this.view.tilt + tilt));
    this.members().forEach((one) => one.draw());
  }

  _zoom(by) {
    this.view.zoom = Math.min(6, Math.max(0.3, this.view.zoom * by));
    this.members().forEach((one) => one.draw());
  }

  draw() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(this.canvas.clientWidth * ratio), height = Math.round(this.canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    const { motion } = this, row = Math.min(Math.round(this.position), motion.rows - 1);
    const [start, stop] = motion.rowsOfFrame(row), body = this._body(this.position, row, start, stop, 1);
    const ghosts = [];
    if (this.ghosts.checked && !this.playing) {
      for (let other = start; other < stop; other++) {
        if (other !== row) ghosts.push(this._body(other, other, start, stop, 0.16));
      }
    }
    // The body last: ghosts nearer to the camera must not veil it.
    this.drawing.draw(this.view, motion.target(this.position), [...ghosts, body]);
    this._tell(row, start, stop);
  }

  _body(position, row, start, stop, opacity) {
    const kind = this.colours.value, when = hfb.timeColour(stop - start > 1 ? (row - start) / (stop - start - 1) : 0.5);
    let colours = new Array(24).fill(when);
    if (kind === "sureness") colours = [...this.motion.sureness(row)].map(hfb.surenessColour);
    if (kind === "person" && opacity === 1) colours = null;
    return { pose: this.motion.pose(position), colours, opacity, parents: this.motion.parents };
  }

  _tell(row, start, stop) {
    const { motion } = this, below = Math.min(Math.floor(this.position), motion.rows - 1);
    const above = Math.min(below + 1, motion.rows - 1), between = this.position > below;
    const closed = between && motion.frames[below] !== motion.frames[above];
    const frames = motion.openings.length > 1 ? `frame ${motion.frames[row]}, ` : "";
    const when = `t = ${(1000 * motion.timeAt(this.position)).toFixed(1)} ms`;
    const slow = this.playing ? `, ${this.slow().toFixed(0)} times slower` : "";
    const state = closed ? "between exposures" : `sub-frame ${row - start + 1} of ${stop - start}`;
    this.clock.textContent = `${frames}${state}, ${when}${slow}`;
    const ramps = {
      time: [[0, 0.5, 1].map(hfb.timeColour), "exposure begins \u2013 ends"],
      sureness: [
        [hfb.SURE_MM, Math.sqrt(hfb.SURE_MM * hfb.UNSURE_MM), hfb.UNSURE_MM].map(hfb.surenessColour),
        `as likely as not within ${hfb.SURE_MM} \u2013 ${hfb.UNSURE_MM} mm`,
      ],
    };
    if (this.legend.dataset.kind === this.colours.value) return;
    this.legend.dataset.kind = this.colours.value;
    this.legend.replaceChildren();
    const ramp = ramps[this.colours.value];
    if (!ramp) return;
    const strip = this.legend.appendChild(document.createElement("span"));
    strip.className = "ramp";
    strip.style.background = `linear-gradient(90deg, ${ramp[0].map(hfb.css).join(", ")})`;
    this.legend.append(ramp[1]);
  }
};

hfb.viewers = [...document.querySelectorAll(".viewer")].map((root) => {
  return new hfb.Viewer(root, JSON.parse(root.querySelector("script.scene").textContent));
});
