// A motion as the page holds it: unpacked, between its sub-frames, and as matrices that carry the rest pose to a pose.
// Coordinates are the camera's (x right, y down, z away from it, metres) until the view turns them.
"use strict";
window.hfb = window.hfb || {};

hfb.unpack = function (text, kind) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return new kind(bytes.buffer);
};

hfb.Motion = class {
  constructor(packed, parents) {
    this.name = packed.name;
    this.parents = parents;
    this.times = hfb.unpack(packed.times, Float64Array);
    this.frames = hfb.unpack(packed.frames, Int32Array);
    this.turns = hfb.unpack(packed.turns, Int16Array);
    this.places = hfb.unpack(packed.places, Float32Array);
    this.rest = hfb.unpack(packed.rest, Float32Array);
    this.radius = packed.radius ? hfb.unpack(packed.radius, Uint16Array) : null;
    this.rows = this.times.length;
    this.openings = [];
    for (let row = 0; row < this.rows; row++) {
      if (row === 0 || this.frames[row] !== this.frames[row - 1]) this.openings.push(row);
    }
    this.interval = this._usualInterval();
    this.targets = this._targets();
  }

  first() { return this.times[0]; }
  last() { return this.times[this.rows - 1]; }

  // Where in the table an instant lies: 2.25 is a quarter of the way from row 2 to row 3.
  at(time) {
    if (this.rows < 2 || time <= this.first()) return 0;
    if (time >= this.last()) return this.rows - 1;
    let low = 0, high = this.rows - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= time) low = middle; else high = middle;
    }
    const step = this.times[high] - this.times[low];
    return step > 0 ? low + (time - this.times[low]) / step : low;
  }

  timeAt(position) {
    const row = Math.min(Math.floor(position), this.rows - 1), next = Math.min(row + 1, this.rows - 1);
    return this.times[row] + (position - row) * (this.times[next] - this.times[row]);
  }

  // The person is away between two rows whose shutters opened further apart than one frame is from the next.
  absentAfter(row) {
    if (row + 1 >= this.rows || this.frames[row] === this.frames[row + 1]) return false;
    return this.times[row + 1] - this.times[this.rowsOfFrame(row)[0]] > 1.5 * this.interval;
  }

  rowsOfFrame(row) {
    let start = row, stop = row + 1;
    while (start > 0 && this.frames[start - 1] === this.frames[row]) start--;
    while (stop < this.rows && this.frames[stop] === this.frames[row]) stop++;
    return [start, stop];
  }

  // {places: joints [m], bones: 24 matrices of three rows of four} at a place in the table.
  pose(position) {
    const row = Math.min(Math.floor(position), this.rows - 1), share = position - row;
    const next = Math.min(row + 1, this.rows - 1);
    const world = [], places = new Float32Array(72), bones = new Float32Array(288);
    for (let joint = 0; joint < 24; joint++) {
      const turn = this._turn(joint, row, next, share), parent = this.parents[joint];
      const local = hfb.rotation(turn), at = 3 * joint;
      world[joint] = parent < 0 ? local : hfb.product(world[parent], local);
      if (parent < 0) {
        for (let k = 0; k < 3; k++) {
          const moved = (1 - share) * this.places[3 * row + k] + share * this.places[3 * next + k];
          places[k] = this.rest[k] + moved;
        }
      } else {
        const bone = [0, 1, 2].map((k) => this.rest[at + k] - this.rest[3 * parent + k]);
        const reached = hfb.turned(world[parent], bone);
        for (let k = 0; k < 3; k++) places[at + k] = places[3 * parent + k] + reached[k];
      }
      const pulled = hfb.turned(world[joint], this.rest.subarray(at, at + 3));
      for (let k = 0; k < 3; k++) {
        bones.set(world[joint].slice(3 * k, 3 * k + 3), 12 * joint + 4 * k);
        bones[12 * joint + 4 * k + 3] = places[at + k] - pulled[k];
      }
    }
    return { places, bones };
  }

  // Radii of the joints [mm] at a row; NaN where nothing is said.
  sureness(row) {
    const found = new Float32Array(24).fill(NaN);
    if (this.radius) {
      for (let joint = 0; joint < 24; joint++) {
        const step = this.radius[24 * row + joint];
        if (step < 65535) found[joint] = step / 10;
      }
    }
    return found;
  }

  target(position) {
    const row = Math.min(Math.floor(position), this.rows - 1), share = position - row;
    const next = Math.min(row + 1, this.rows - 1);
    return [0, 1, 2].map((k) => (1 - share) * this.targets[3 * row + k] + share * this.targets[3 * next + k]);
  }

  _turn(joint, row, next, share) {
    const a = 4 * (24 * row + joint), b = 4 * (24 * next + joint), turn = [0, 0, 0, 0];
    let dot = 0, length = 0;
    for (let k = 0; k < 4; k++) dot += this.turns[a + k] * this.turns[b + k];
    for (let k = 0; k < 4; k++) {
      turn[k] = (1 - share) * this.turns[a + k] + share * (dot < 0 ? -1 : 1) * this.turns[b + k];
      length += turn[k] * turn[k];
    }
    return turn.map((value) => value / Math.sqrt(length));
  }

  _usualInterval() {
    const steps = this.openings.slice(1).map((row, k) => this.times[row] - this.times[this.openings[k]]);
    steps.sort((a, b) => a - b);
    return steps.length ? steps[steps.length >> 1] : Infinity;
  }

  // What the view looks at: where the pelvis is on average within half a second, so that it follows smoothly.
  _targets() {
    const found = new Float32Array(3 * this.rows), sums = new Float64Array(3 * (this.rows + 1));
    for (let row = 0; row < this.rows; row++) {
      for (let k = 0; k < 3; k++) sums[3 * (row + 1) + k] = sums[3 * row + k] + this.places[3 * row + k] + this.rest[k];
    }
    let start = 0, stop = 0;
    for (let row = 0; row < this.rows; row++) {
      while (this.times[start] < this.times[row] - 0.5) start++;
      while (stop < this.rows && this.times[stop] <= this.times[row] + 0.5) stop++;
      for (let k = 0; k < 3; k++) found[3 * row + k] = (sums[3 * stop + k] - sums[3 * start + k]) / (stop - start);
    }
    return found;
  }
};

hfb.rotation = function ([w, x, y, z]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
};

hfb.product = function (a, b) {
  const found = new Array(9);
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j < 3; j++) found[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
  }
  return found;
};

hfb.turned = function (m, v) {
  return [0, 3, 6].map((k) => m[k] * v[0] + m[k + 1] * v[1] + m[k + 2] * v[2]);
};

// From blue (the exposure begins) over violet to orange (it ends), as in the strip of pictures.
hfb.timeColour = function (share) {
  const marks = [[0.35, 0.58, 0.98], [0.8, 0.5, 0.85], [0.99, 0.62, 0.27]];
  const [from, to, part] = share < 0.5 ? [marks[0], marks[1], 2 * share] : [marks[1], marks[2], 2 * share - 1];
  return from.map((value, k) => value + part * (to[k] - value));
};

// From green (within 20 mm) over yellow to red (150 mm and more), by the logarithm; grey where nothing is said.
hfb.SURE_MM = 20;
hfb.UNSURE_MM = 150;
hfb.surenessColour = function (radius) {
  if (!(radius >= 0)) return [0.62, 0.64, 0.66];
  const marks = [[0.13, 0.6, 0.42], [0.96, 0.8, 0.25], [0.84, 0.2, 0.16]];
  const span = Math.log(hfb.UNSURE_MM / hfb.SURE_MM);
  const share = Math.min(1, Math.max(0, Math.log(Math.max(radius, 1) / hfb.SURE_MM) / span));
  const [from, to, part] = share < 0.5 ? [marks[0], marks[1], 2 * share] : [marks[1], marks[2], 2 * share - 1];
  return from.map((value, k) => value + part * (to[k] - value));
};

// A side to look from: a rotation into view axes (x right, y up, z towards the eye) and how far the eye is.
hfb.View = class {
  constructor(reach) {
    this.reach = reach; // the radius [m] of what is to be seen
    this.yaw = 0;
    this.tilt = 0;
    this.zoom = 1;
  }

  turn() {
    const cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), ct = Math.cos(this.tilt), st = Math.sin(this.tilt);
    const upright = [1, 0, 0, 0, -1, 0, 0, 0, -1]; // the camera's axes, y up and z towards the eye
    const aside = [cy, 0, sy, 0, 1, 0, -sy, 0, cy], above = [1, 0, 0, 0, ct, -st, 0, st, ct];
    return hfb.product(above, hfb.product(aside, upright));
  }

  distance(aspect) {
    return this.reach / (Math.tan(hfb.HALF_ANGLE) * Math.min(1, aspect) * this.zoom);
  }
};
hfb.HALF_ANGLE = 0.26; // of the eye's view, up and down [rad]
