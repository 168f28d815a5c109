// The page: playback, the view, prompts and keys.

// Pixels of the canvas along a recorded one: at most, at least, and at first.
const MOST_DETAIL = 3, LEAST_DETAIL = 0.75, FIRST_DETAIL = 1.5;
const SLOW = 40; // milliseconds of a frame beyond which a picture that changes is drawn coarser
const REST = 250; // milliseconds without a change after which it is drawn sharply
const RADIANS_PER_POINT = 0.0021;

const byId = (id) => document.getElementById(id);
const canvas = document.querySelector("canvas");

class Player {
  constructor(scene) {
    const asked = new URLSearchParams(location.hash.slice(1));
    Object.assign(this, { scene, plays: false, drawn: -1, detail: FIRST_DETAIL, orbit: { yaw: 0, pitch: 0 }, shown: new Set() });
    this.last = scene.frames.length - 1;
    this.frame = this.clamped((parseInt(asked.get("frame"), 10) || 0) - scene.first);
    this.isExact = asked.has("recorded"); // as many pixels as recorded
    this.painter = new Painter(canvas, scene);
    this.listPrompts();
    this.listen();
    Object.assign(byId("frame"), { min: scene.first, max: scene.first + this.last });
    byId("message").hidden = true;
    this.draw();
  }

  clamped(frame) {
    return Math.max(0, Math.min(this.last, frame));
  }

  get isRecorded() {
    return this.orbit.yaw === 0 && this.orbit.pitch === 0;
  }

  go(frame) {
    this.frame = this.clamped(frame);
    this.drawSoon();
  }

  drawSoon() {
    this.due ??= requestAnimationFrame(() => this.draw());
  }

  // A picture that rests is drawn sharply, one that changes no finer than this machine draws fast.
  draw(rests = false) {
    this.due = undefined;
    const { scene, frame, painter } = this, recorded = cameraOf(scene.frames[frame].camera);
    const start = performance.now(), size = this.fit(recorded.size, rests ? MOST_DETAIL : this.detail);
    if (rests && size[0] === painter.width && size[1] === painter.height) return;
    const camera = this.isRecorded ? recorded : turned(recorded, this.orbit, scene.pivot_depth);
    if (this.drawn !== frame || scene.bands) {
      scene.move(frame, positionOf(camera));
      painter.takeGaussians();
    }
    const prompts = scene.prompts.filter((prompt) => this.shown.has(prompt) && prompt.frames[frame] === "found");
    painter.draw(resized(camera, ...size), this.isRecorded, prompts);
    this.drawn = frame;
    clearTimeout(this.resting);
    if (!rests) {
      if (!this.plays) this.resting = setTimeout(() => this.draw(true), REST);
      painter.whenDone(() => this.adapt(size[0] / recorded.size[0], performance.now() - start));
    }
    this.say();
    document.body.dataset.drawn = scene.first + frame;
  }

  // Chooses the detail of the next picture by the time that one took.
  adapt(pixels, milliseconds) {
    const detail = pixels * Math.sqrt(SLOW / Math.max(1, milliseconds));
    this.detail = Math.max(LEAST_DETAIL, Math.min(MOST_DETAIL, 0.5 * (this.detail + detail)));
  }

  // Fits the picture into the stage; returns its number of pixels.
  fit([width, height], most) {
    const { clientWidth, clientHeight } = byId("stage"), scale = Math.min(clientWidth / width, clientHeight / height);
    canvas.style.width = `${Math.max(1, Math.floor(width * scale))}px`;
    canvas.style.height = `${Math.max(1, Math.floor(height * scale))}px`;
    const detail = this.isExact ? 1 : Math.min(most, Math.max(0.5, scale * devicePixelRatio));
    const side = this.painter.gl.getParameter(this.painter.gl.MAX_RENDERBUFFER_SIZE) / Math.max(width, height);
    return [width, height].map((n) => Math.max(1, Math.round(n * Math.min(detail, side))));
  }

  say() {
    const { scene, frame, last } = this, seconds = scene.seconds ? ` · ${scene.seconds[frame].toFixed(2)} s` : "";
    byId("frame").value = scene.first + frame;
    byId("place").textContent = `Frame ${scene.first + frame + 1} of ${scene.first + last + 1}${seconds}`;
    byId("turned").hidden = this.isRecorded;
    byId("reset").disabled = this.isRecorded;
    for (const prompt of scene.prompts) {
      const is = prompt.frames[frame], near = prompt.nearest ? `looks like ${prompt.nearest}` : "";
      const here = { found: "found on this frame", nearest: `not found; ${near}`, absent: "not on this frame" }[is];
      prompt.line.textContent = prompt.note || here;
      prompt.line.className = is === "found" ? "is-found" : "";
    }
  }

  play(plays) {
    this.plays = plays;
    byId("play").classList.toggle("plays", plays);
    byId("play").setAttribute("aria-label", plays ? "Pause" : "Play");
    cancelAnimationFrame(this.ticking);
    if (!plays) return this.drawSoon();
    let end = 0, start;
    const ends = this.scene.lasts.map((lasts) => (end += lasts)); // seconds at which each frame is over
    const from = this.frame === this.last ? 0 : (ends[this.frame - 1] ?? 0);
    const tick = (now) => {
      start ??= now;
      const seconds = (from + (now - start) / 1000) % end, frame = Math.max(0, ends.findIndex((over) => seconds < over));
      if (frame !== this.drawn) {
        this.frame = frame;
        this.draw();
      }
      this.ticking = requestAnimationFrame(tick);
    };
    this.ticking = requestAnimationFrame(tick);
  }

  turn(x, y) {
    const yaw = this.orbit.yaw - x * RADIANS_PER_POINT, pitch = this.orbit.pitch - y * RADIANS_PER_POINT;
    const share = Math.min(1, this.scene.most_turn / Math.max(1e-9, Math.hypot(yaw, pitch)));
    this.orbit = { yaw: yaw * share, pitch: pitch * share };
    this.drawSoon();
  }

  reset() {
    this.orbit = { yaw: 0, pitch: 0 };
    this.drawSoon();
  }

  toggle(prompt, shows) {
    if (shows) this.shown.add(prompt);
    else this.shown.delete(prompt);
    this.drawSoon();
  }

  listPrompts() {
    const { prompts } = this.scene, list = document.querySelector("#prompts ul");
    byId("prompts").hidden = prompts.length === 0;
    for (const prompt of prompts) {
      const [label, box, swatch, name, line] = ["label", "input", "span", "b", "small"].map((tag) => document.createElement(tag));
      const isEver = prompt.frames.includes("found"), colour = `rgb(${prompt.colour})`;
      Object.assign(box, { type: "checkbox", checked: isEver, disabled: !isEver });
      box.addEventListener("change", () => this.toggle(prompt, box.checked));
      if (isEver) this.shown.add(prompt);
      swatch.className = "swatch";
      swatch.style.background = colour;
      name.textContent = prompt.text;
      Object.assign(prompt, { box, line });
      label.classList.toggle("never", !isEver);
      label.append(box, swatch, name, line);
      if (isEver) label.append(lane(prompt, colour));
      list.append(document.createElement("li"));
      list.lastChild.append(label);
    }
  }

  listen() {
    byId("play").addEventListener("click", () => this.play(!this.plays));
    byId("reset").addEventListener("click", () => this.reset());
    byId("frame").addEventListener("input", (event) => this.scrub(event.target.valueAsNumber - this.scene.first));
    addEventListener("keydown", (event) => this.press(event));
    new ResizeObserver(() => this.drawSoon()).observe(byId("stage"));
    let from;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      from = event;
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      this.turn(event.clientX - from.clientX, event.clientY - from.clientY);
      from = event;
    });
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.painter = new Painter(canvas, this.scene);
      this.drawn = -1;
      this.drawSoon();
    });
  }

  scrub(frame) {
    if (this.plays) this.play(false);
    this.go(frame);
  }

  press(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const { frame, last } = this, prompt = this.scene.prompts[Number(event.key) - 1];
    const isButton = event.key === " " && ["BUTTON", "INPUT"].includes(event.target.tagName) && event.target.id !== "frame";
    const acts = {
      " ": () => this.play(!this.plays), r: () => this.reset(), Home: () => this.scrub(0), End: () => this.scrub(last),
      ArrowLeft: () => this.scrub(frame - 1), ArrowRight: () => this.scrub(frame + 1),
      PageUp: () => this.scrub(frame - 10), PageDown: () => this.scrub(frame + 10),
    };
    const act = acts[event.key.length === 1 ? event.key.toLowerCase() : event.key] ?? (prompt && (() => prompt.box.click()));
    if (!act || isButton) return;
    event.preventDefault();
    act();
  }
}

// A strip that shows on which frames a prompt is found.
function lane({ frames }, colour) {
  const strip = document.createElement("span"), share = (k) => `${((100 * k) / frames.length).toFixed(2)}%`;
  const stops = frames.map((is, k) => `${is === "found" ? colour : "#8885"} ${share(k)} ${share(k + 1)}`);
  strip.className = "lane";
  strip.style.background = `linear-gradient(to right, ${stops.join(", ")})`;
  return strip;
}

try {
  if (!globalThis.DecompressionStream) throw new Error("This browser cannot open the scene. A newer one will.");
  new Player(await Scene.open(JSON.parse(byId("scene").textContent), byId("data").textContent));
} catch (error) {
  byId("message").hidden = false;
  byId("message").textContent = error.message;
}
