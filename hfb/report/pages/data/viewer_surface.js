// The skinned body in WebGL2: the rest pose lies on the graphics card, each picture sends 24 matrices.
"use strict";

hfb.VERTEX_SHADER = `#version 300 es
layout(location = 0) in vec3 vertex;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 place;
layout(location = 3) in uvec4 joints0;
layout(location = 4) in uvec4 joints1;
layout(location = 5) in vec4 weights0;
layout(location = 6) in vec4 weights1;
uniform vec4 bones[72];
uniform vec3 tints[24];
uniform mat3 turn;
uniform vec3 target;
uniform vec4 lens; // scale across, scale up, distance, reach
out vec3 facing;
out vec3 tint;
out vec2 at;
void main() {
  vec4 rows[3] = vec4[3](vec4(0), vec4(0), vec4(0));
  vec3 colour = vec3(0);
  float whole = 0.0;
  for (int k = 0; k < 8; k++) {
    uint joint = k < 4 ? joints0[k] : joints1[k - 4];
    float weight = k < 4 ? weights0[k] : weights1[k - 4];
    for (int row = 0; row < 3; row++) rows[row] += weight * bones[3u * joint + uint(row)];
    colour += weight * tints[joint];
    whole += weight;
  }
  vec4 rest = vec4(vertex, 1.0);
  vec3 posed = vec3(dot(rows[0], rest), dot(rows[1], rest), dot(rows[2], rest)) / whole;
  vec3 bent = vec3(dot(rows[0].xyz, normal), dot(rows[1].xyz, normal), dot(rows[2].xyz, normal));
  vec3 seen = turn * (posed - target);
  float depth = lens.z - seen.z;
  float near = 0.05, far = lens.z + 4.0 * lens.w + 1.0;
  gl_Position = vec4(seen.x * lens.x, seen.y * lens.y, (depth * (far + near) - 2.0 * far * near) / (far - near), depth);
  facing = turn * bent;
  tint = colour / whole;
  at = place;
}`;

hfb.FRAGMENT_SHADER = `#version 300 es
precision highp float;
in vec3 facing;
in vec3 tint;
in vec2 at;
uniform sampler2D skin;
uniform float textured;
uniform float opacity;
out vec4 drawn;
void main() {
  vec3 light = normalize(vec3(-0.35, 0.55, 0.76)); // above the viewer's left shoulder
  float shade = 0.42 + 0.58 * max(dot(normalize(facing), light), 0.0);
  vec3 colour = mix(tint, texture(skin, at).rgb, textured);
  drawn = vec4(colour * shade * opacity, opacity);
}`;

hfb.Surface = class {
  // Throws where WebGL2 is missing.
  constructor(canvas, skin, texture, redraw) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });
    if (!gl) throw new Error("no WebGL2");
    this.canvas = canvas;
    this.gl = gl;
    this.kind = "surface";
    this.skin = skin;
    this.texture = texture;
    this._prepare(redraw);
    // A graphics card that slept or was taken away forgets everything; a context whose loss is not refused stays lost.
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => { this._prepare(redraw); redraw(); });
  }

  // bodies: {pose, colours (24) or null for the texture, opacity}; what is opaque comes last.
  draw(view, target, bodies) {
    const { gl, canvas } = this, aspect = canvas.width / canvas.height;
    const distance = view.distance(aspect), scale = 1 / Math.tan(hfb.HALF_ANGLE);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.program);
    gl.bindVertexArray(this.points);
    gl.uniformMatrix3fv(this.place.turn, true, view.turn());
    gl.uniform3fv(this.place.target, target);
    gl.uniform4f(this.place.lens, scale / aspect, scale, distance, view.reach);
    for (const body of bodies) {
      gl.uniform4fv(this.place.bones, body.pose.bones);
      gl.uniform3fv(this.place.tints, (body.colours || new Array(24).fill([0.72, 0.66, 0.62])).flat());
      gl.uniform1f(this.place.textured, body.colours === null && this.textured ? 1 : 0);
      gl.uniform1f(this.place.opacity, body.opacity);
      gl.depthMask(body.opacity === 1);
      gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    }
  }

  _prepare(redraw) {
    const { gl } = this;
    this.textured = false;
    this.program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, hfb.VERTEX_SHADER], [gl.FRAGMENT_SHADER, hfb.FRAGMENT_SHADER]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) throw new Error("WebGL2 takes no skinned body");
    this.place = {};
    for (const name of ["bones", "tints", "turn", "target", "lens", "textured", "opacity"]) {
      this.place[name] = gl.getUniformLocation(this.program, name);
    }
    this.points = gl.createVertexArray();
    gl.bindVertexArray(this.points);
    const { skin } = this;
    this._attribute(0, hfb.unpack(skin.vertices, Float32Array), 3, gl.FLOAT);
    this._attribute(1, hfb.unpack(skin.normals, Int8Array), 4, gl.BYTE, true);
    this._attribute(2, hfb.unpack(skin.uv, Uint16Array), 2, gl.UNSIGNED_SHORT, true);
    const joints = this._buffer(hfb.unpack(skin.joints, Uint8Array));
    const weights = this._buffer(hfb.unpack(skin.weights, Uint8Array));
    for (let set = 0; set < 2; set++) {
      gl.bindBuffer(gl.ARRAY_BUFFER, joints);
      gl.enableVertexAttribArray(3 + set);
      gl.vertexAttribIPointer(3 + set, 4, gl.UNSIGNED_BYTE, 8, 4 * set);
      gl.bindBuffer(gl.ARRAY_BUFFER, weights);
      gl.enableVertexAttribArray(5 + set);
      gl.vertexAttribPointer(5 + set, 4, gl.UNSIGNED_BYTE, true, 8, 4 * set);
    }
    const corners = hfb.unpack(skin.corners, Uint32Array);
    this.count = corners.length;
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.CULL_FACE);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([184, 168, 158, 255]));
    if (this.texture) this._load(this.texture, redraw);
  }

  _buffer(values) {
    const { gl } = this, buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    return buffer;
  }

  _attribute(at, values, size, kind, normalized = false) {
    const { gl } = this;
    this._buffer(values);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, size, kind, normalized, 0, 0);
  }

  _load(address, redraw) {
    const { gl } = this, image = new Image();
    image.onload = () => {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
      for (const [name, value] of [
        [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
        [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
      ]) gl.texParameteri(gl.TEXTURE_2D, name, value);
      this.textured = true;
      redraw();
    };
    image.src = address;
  }
};
