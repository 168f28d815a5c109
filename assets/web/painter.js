// Draws the scene with WebGL 2: splats are blended into a texture, which is then shown.

const NOT_SUPPORTED = "This browser cannot draw the scene: it lacks WebGL 2. Another browser, or a newer one, will.";

class Painter {
  constructor(canvas, scene) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error(NOT_SUPPORTED);
    Object.assign(this, { gl, canvas, scene });
    this.splats = this.program("splats.vert", "splats.frag");
    this.picture = this.program("screen.vert", "picture.frag");
    this.found = this.program("screen.vert", "found.frag");
    // Half floats do not round what many splats add up to; without them, bytes have to do.
    const blends = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
    this.format = blends ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
    this.blended = this.texture();
    this.target = gl.createFramebuffer();
    this.gaussians = this.texture();
    this.shares = this.texture();
    this.fieldOfView = this.texture(gl.LINEAR);
    this.order = this.texture();
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.fillFieldOfView();
    this.makeCorners();
  }

  program(...names) {
    const { gl } = this, { limits } = this.scene, program = gl.createProgram();
    const number = ([name, value]) => `#define ${name} ${Number.isInteger(value) ? `${value}.0` : value}\n`;
    const head = `#version 300 es\nprecision highp float;\n#define TEXELS ${TEXELS}\n${Object.entries(limits).map(number).join("")}`;
    for (const name of names) {
      const shader = gl.createShader(name.endsWith(".vert") ? gl.VERTEX_SHADER : gl.FRAGMENT_SHADER);
      gl.shaderSource(shader, head + document.getElementById(name).textContent);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error(`This browser cannot draw the scene: ${logs.join(" ") || gl.getProgramInfoLog(program)}`);
    }
    const places = {};
    return { program, place: (name) => (places[name] ??= gl.getUniformLocation(program, name)) };
  }

  texture(between = this.gl.NEAREST) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, between);
    for (const edge of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, edge, gl.CLAMP_TO_EDGE);
    return texture;
  }

  fill(texture, inside, width, height, format, type, values) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, height, 0, format, type, values);
  }

  fillFieldOfView() {
    const { gl, scene } = this, [width, height] = scene.field, row = Math.ceil(width / 8);
    const pixels = new Uint8Array(width * height);
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++) pixels[y * width + x] = (scene.fieldOfView[y * row + (x >> 3)] >> (7 - (x & 7))) & 1 ? 255 : 0;
    }
    this.fill(this.fieldOfView, gl.R8, width, height, gl.RED, gl.UNSIGNED_BYTE, pixels);
  }

  // Two triangles for each Gaussian. Instances would be fewer numbers, but software draws them one by one.
  makeCorners() {
    const { gl, scene } = this, corners = new Uint32Array(6 * scene.count);
    for (let k = 0; k < corners.length; k++) corners[k] = 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6];
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
  }

  // Takes over the Gaussians as they are now.
  takeGaussians() {
    const { gl, scene } = this;
    this.fill(this.gaussians, gl.RGBA32F, TEXELS, scene.rows, gl.RGBA, gl.FLOAT, scene.now);
  }

  resize(width, height) {
    const { gl, canvas, format } = this;
    if (this.width === width && this.height === height) return;
    Object.assign(this, { width, height });
    Object.assign(canvas, { width, height });
    this.fill(this.blended, format[0], width, height, gl.RGBA, format[1], null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.blended, 0);
  }

  // Draws a view, and over it what `prompts` found.
  draw(camera, isRecorded, prompts) {
    const { gl } = this, order = this.scene.order(camera);
    this.resize(...camera.size);
    gl.viewport(0, 0, this.width, this.height);
    this.takeOrder(order);
    this.blend(camera, order.length, false);
    this.show(this.picture, isRecorded);
    for (let k = 0; k < prompts.length; k += 3) {
      this.takeShares(prompts.slice(k, k + 3));
      this.blend(camera, order.length, true);
      this.show(this.found, isRecorded, prompts.slice(k, k + 3));
    }
  }

  takeOrder(order) {
    const { gl } = this, rows = Math.max(1, Math.ceil(order.length / TEXELS)), texels = new Uint32Array(rows * TEXELS);
    texels.set(order);
    this.fill(this.order, gl.R32UI, TEXELS, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, texels);
  }

  // Calls `act` once everything is drawn.
  whenDone(act) {
    const { gl } = this, fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (!fence) return;
    gl.flush();
    const look = () => {
      if (gl.isContextLost()) return;
      if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) return setTimeout(look, 4);
      gl.deleteSync(fence);
      act();
    };
    setTimeout(look, 0);
  }

  // Lays the shares of up to three prompts into red, green and blue.
  takeShares(prompts) {
    const { gl, scene } = this, texels = new Uint8Array(scene.rows * TEXELS);
    prompts.forEach(({ shares }, k) => shares.forEach((share, i) => (texels[4 * i + k] = share)));
    this.fill(this.shares, gl.RGBA8, TEXELS / 4, scene.rows, gl.RGBA, gl.UNSIGNED_BYTE, texels);
  }

  blend({ rotation: r, translation, lens, size }, count, showsShares) {
    const { gl, splats: { program, place }, scene } = this;
    const slack = size.map((side) => 0.5 * (scene.limits.FRUSTUM_GUARD - 1) * side);
    const guard = [0, 1].map((k) => (-lens[2 + k] - slack[k]) / lens[k]);
    guard.push(...[0, 1].map((k) => (size[k] - lens[2 + k] + slack[k]) / lens[k]));
    gl.useProgram(program);
    gl.uniformMatrix3fv(place("rotation"), false, [0, 3, 6, 1, 4, 7, 2, 5, 8].map((k) => r[k]));
    gl.uniform3fv(place("translation"), translation);
    gl.uniform4fv(place("lens"), lens);
    gl.uniform4fv(place("guard"), guard);
    gl.uniform2fv(place("size"), size);
    gl.uniform1i(place("showsShares"), showsShares);
    this.bind(place, { gaussians: this.gaussians, shares: this.shares, order: this.order });
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawElements(gl.TRIANGLES, 6 * count, gl.UNSIGNED_INT, 0);
  }

  // Brings what was blended onto the canvas: as the picture, or as what was found over it.
  show({ program, place }, isRecorded, prompts) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(program);
    gl.uniform2f(place("size"), this.width, this.height);
    gl.uniform1i(place("isRecorded"), isRecorded);
    this.bind(place, { blended: this.blended, fieldOfView: this.fieldOfView });
    if (prompts) {
      const colours = [0, 1, 2].flatMap((k) => (prompts[k]?.colour ?? [0, 0, 0]).map((v) => v / 255));
      gl.uniform3fv(place("colours"), colours);
      gl.uniform1f(place("line"), Math.max(1, Math.min(this.width, this.height) / 320));
    } else {
      gl.disable(gl.BLEND);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  bind(place, textures) {
    const { gl } = this;
    Object.entries(textures).forEach(([name, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(place(name), unit);
    });
    gl.activeTexture(gl.TEXTURE0);
  }
}
