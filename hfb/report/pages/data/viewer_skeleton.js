// The skeleton on a plain canvas: for browsers without WebGL2, and for motions whose body model is not in the page.
"use strict";

hfb.Skeleton = class {
  constructor(canvas) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.kind = "skeleton";
  }

  // bodies: from the one furthest behind to the one in front, each {pose, colours (24), opacity}.
  draw(view, target, bodies) {
    const { canvas, pen } = this, aspect = canvas.width / canvas.height;
    const turn = view.turn(), distance = view.distance(aspect), scale = canvas.height / 2 / Math.tan(hfb.HALF_ANGLE);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.lineCap = "round";
    for (const body of bodies) {
      const seen = [];
      for (let joint = 0; joint < 24; joint++) {
        const [x, y, z] = hfb.turned(turn, [0, 1, 2].map((k) => body.pose.places[3 * joint + k] - target[k]));
        const near = scale / Math.max(distance - z, 0.05);
        seen.push([canvas.width / 2 + x * near, canvas.height / 2 - y * near, near]);
      }
      pen.globalAlpha = body.opacity;
      for (let joint = 1; joint < 24; joint++) {
        const [x, y, near] = seen[joint], [px, py] = seen[body.parents[joint]];
        pen.strokeStyle = hfb.css(body.colours[joint]);
        pen.lineWidth = 0.05 * near;
        pen.beginPath();
        pen.moveTo(px, py);
        pen.lineTo(x, y);
        pen.stroke();
      }
      const [x, y, near] = seen[15];
      pen.fillStyle = hfb.css(body.colours[15]);
      pen.beginPath();
      pen.arc(x, y - 0.06 * near, 0.1 * near, 0, 2 * Math.PI);
      pen.fill();
    }
    pen.globalAlpha = 1;
  }
};

hfb.css = (colour) => `rgb(${colour.map((value) => Math.round(255 * value)).join(" ")})`;
