// Plays a trace (docs/replay.md) inside an element:
//
//   const player = await play(element, bytes);
//   player.pause(); player.frames; player.destroy();
//
// page.py puts this module and those it imports into one script.
import { decode } from "./decode.js";
import { fill, h, s } from "./elements.js";
import { Panel } from "./panel.js";
import { Picture } from "./picture.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const SECONDS = 20, SLOWEST = 3,
  FASTEST = 500; // of a trial at speed 1; frames per second at least and at most
const PANEL_MS = 80; // between updates of the numbers
const ICONS = { // paths in a square of 16
  start: "M2 2h3v12H2zM14 2v12L5 8z", back: "M12 2v12L3 8z", play: "M4 2v12l10-6z",
  pause: "M3 2h4v12H3zM9 2h4v12H9z", ahead: "M3 2v12l8-6zM12 2h2v12h-2z",
};
const KEYS = {
  space: "play, pause", "← →": "a round back, ahead; with shift ten", "Home End": "start, end",
  "+ −": "faster, slower", "[ ]": "the previous agent, the next one", "T, S": "trails, sensors",
};

/** Build a player.
 * @param {HTMLElement} element emptied, and filled with it
 * @param {Uint8Array|ArrayBuffer} bytes of a trace
 * @returns {Promise<{pause: function, destroy: function, frames: number}>} frames: pictures drawn so far
 */
export async function play(element, bytes) {
  const player = new Player(element, await decode(bytes));
  return {
    pause: () => player.pause(),
    destroy: () => player.destroy(),
    get frames() { return player.drawn; },
  };
}

class Player extends Picture {
  constructor(element, trace) {
    super(trace);
    this.element = element;
    this.speed = 1;
    this.playing = false;
    this.drawn = 0;
    this.panelAt = 0;
    this.perSecond = Math.min(Math.max(this.last / SECONDS, SLOWEST), FASTEST);
    this.build();
    this.listen();
    this.restyle();
    if (trace.agents) this.choose(0);
    this.resize();
    if (!this.still.matches) this.play();
  }

  build() {
    const { trace } = this, { about, error, note } = trace;
    const parts = ["generation", "candidate", "trial"].filter((key) => about[key] !== undefined);
    const title = [about.run ?? about.simulator ?? "",
      ...parts.map((key) => `${key} ${about[key] + (key === "generation")}`)].join(" · ");
    const metrics = Object.entries(trace.metrics).map(([key, value]) => `${key} ${shown(value)}`);
    const result = [`fitness ${trace.fitness.map(shown).join(", ")}`, ...metrics].join(" · ");
    const notes = [note, error && `the trial failed: ${error}`].filter(Boolean);
    const why = trace.no_picture ? ` (${trace.no_picture})` : "";
    const rest = "what the agents observe and set is shown alone.";
    const missing = `This simulator draws no picture${why}: ${rest}`;
    this.canvas = h("canvas", { class: "zp-canvas", role: "img" });
    this.stage = trace.width ? h("div", {}, this.canvas)
      : h("p", { class: "zp-dim", text: missing });
    this.panel = new Panel(this);
    this.root = h("section", { class: "zp", "aria-label": "replay of a trial" },
      h("h2", { class: "zp-title", text: title }), h("p", { class: "zp-result", text: result }),
      ...notes.map((text) => h("p", { class: "zp-note", text, role: "alert" })),
      h("div", { class: "zp-row" },
        h("div", { class: "zp-left" }, this.stage, this.bar(), this.legend()), this.panel.element),
      this.facts());
    fill(this.element, this.root);
  }

  bar() {
    const { trace } = this;
    this.slider = h("input", {
      class: "zp-slider", "aria-label": "round", type: "range", min: 0, max: this.last, step: 1,
      value: 0,
      oninput: () => this.go(Number(this.slider.value)) });
    this.playButton = button("play", "play", () => this.toggle());
    this.clock = h("span", { class: "zp-clock" });
    this.speeds = select("speed", SPEEDS.map((speed) => [speed, `×${speed}`]),
      (value) => { this.speed = value; });
    this.speeds.value = 1;
    const agents = Array.from({ length: trace.agents }, (_, i) => [i, `agent ${i}`]);
    this.agents = select("agent", [[-1, "no agent"], ...agents], (value) => this.choose(value));
    return h("div", { class: "zp-bar", role: "group", "aria-label": "playing" },
      h("div", { class: "zp-line" },
        button("back to the start", "start", () => this.go(0)),
        button("a round back", "back", () => this.step(-1)),
        this.playButton, button("a round ahead", "ahead", () => this.step(1)), this.slider,
        this.clock),
      h("div", { class: "zp-line" }, this.speeds, trace.width && this.checkbox("trails", "trails"),
        trace.rays?.length > 0 && this.checkbox("sensors", "rays"),
        trace.agents > 0 && this.agents));
  }

  checkbox(text, name) {
    this[`${name}Box`] = h("input", {
      type: "checkbox", checked: this[name],
      onchange: (event) => { this[name] = event.target.checked; this.draw(); } });
    return h("label", { class: "zp-check" }, this[`${name}Box`], text);
  }

  legend() {
    const kinds = this.trace.kinds ?? [];
    this.swatches = kinds.map(() => h("canvas",
      { class: "zp-swatch", "aria-hidden": "true", width: 32, height: 32 }));
    return h("ul", { class: "zp-legend", "aria-label": "what is shown" },
      ...kinds.map((kind, i) => h("li", {}, this.swatches[i], kind)));
  }

  facts() {
    const words = (value) => (typeof value === "object" ? JSON.stringify(value) : String(value));
    return h("details", { class: "zp-facts" },
      h("summary", { text: "details and keyboard shortcuts" }),
      h("dl", {}, ...Object.entries({ ...this.trace.about, ...KEYS }).flatMap(([key, value]) => [
        h("dt", { text: key }), h("dd", { text: words(value) })])));
  }

  // ---- input

  listen() {
    this.abort = new AbortController();
    const { signal } = this.abort, { body, documentElement } = document;
    const listen = (target, event, act) => target.addEventListener(event, act, { signal });
    listen(this.root, "keydown", (event) => this.key(event));
    listen(document, "keydown", (event) => {
      if (event.target === body || event.target === documentElement) this.key(event);
    });
    listen(this.canvas, "pointerdown", (event) => this.touch(event));
    const dark = window.matchMedia("(prefers-color-scheme: dark)");
    for (const media of [dark, this.still]) listen(media, "change", () => this.restyle());
    listen(document, "visibilitychange", () => { this.before = undefined; });
    this.themes = new MutationObserver(() => this.restyle());
    this.themes.observe(documentElement, { attributes: true, attributeFilter: ["data-theme"] });
    this.sizes = new ResizeObserver(() => requestAnimationFrame(() => this.root.isConnected
      && this.resize()));
    this.sizes.observe(this.root);
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select")) return;
    const on = event.target.closest("button, summary, input"),
      slider = event.target === this.slider;
    const acts = {
      " ": () => !(on && !slider) && this.toggle(),
      ArrowLeft: () => !slider && this.step(event.shiftKey ? -10 : -1),
      ArrowRight: () => !slider && this.step(event.shiftKey ? 10 : 1),
      Home: () => this.go(0),
      End: () => this.go(this.last),
      "+": () => this.faster(1),
      "=": () => this.faster(1),
      "-": () => this.faster(-1),
      "[": () => this.choose(this.chosen - 1),
      "]": () => this.choose(this.chosen + 1),
      t: () => this.trailsBox?.click(),
      s: () => this.raysBox?.click(),
    };
    const act = acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (act && act() !== false) event.preventDefault();
  }

  touch(event) {
    const box = this.canvas.getBoundingClientRect(), { trace, view } = this;
    const x = (event.clientX - box.left) / view.scale + view.left,
      y = (event.clientY - box.top) / view.scale + view.top;
    let best = -1, least = 24 / view.scale; // the reach of a finger
    for (let agent = 0; agent < Math.min(trace.agents, this.bodies); agent += 1) {
      const [bx, by] = this.place(agent), away = Math.hypot(bx - x, by - y) - trace.radii[agent];
      if (away < least) [best, least] = [agent, away];
    }
    this.choose(best);
  }

  toggle() { if (this.playing) this.pause(); else this.play(); }

  play() {
    if (this.at >= this.last) this.at = 0;
    this.before = undefined;
    this.showState(true);
    this.request ??= requestAnimationFrame((now) => this.tick(now));
  }

  pause() {
    this.go(this.at);
  }

  showState(playing) {
    this.playing = playing;
    const name = playing ? "pause" : "play";
    this.playButton.title = name;
    this.playButton.setAttribute("aria-label", name);
    fill(this.playButton, icon(name));
  }

  step(by) {
    this.go(Math.min(Math.max((by < 0 ? Math.ceil(this.at) : Math.floor(this.at)) + by, 0),
      this.last));
  }

  go(at) {
    this.at = at;
    this.showState(false);
    this.draw();
  }

  faster(by) {
    const at = Math.min(Math.max(SPEEDS.indexOf(this.speed) + by, 0), SPEEDS.length - 1);
    this.speed = SPEEDS[at];
    this.speeds.value = this.speed;
  }

  choose(agent) {
    if (!this.trace.agents || agent >= this.trace.agents || agent < -1) return;
    this.chosen = agent;
    this.agents.value = agent;
    this.panel.title.textContent = agent < 0 ? "no agent chosen" : `agent ${agent}`;
    this.panel.map.prepare();
    this.draw();
  }

  destroy() {
    this.playing = false;
    cancelAnimationFrame(this.request);
    this.abort.abort();
    this.themes.disconnect();
    this.sizes.disconnect();
    fill(this.element);
  }

  // ---- pictures

  tick(now) {
    this.request = undefined;
    if (!this.playing) return;
    const passed = this.before === undefined ? 0 : Math.min((now - this.before) / 1000, 0.25);
    this.before = now;
    this.at = Math.min(this.at + passed * this.perSecond * this.speed, this.last);
    if (this.at === this.last) this.showState(false);
    this.draw();
    if (this.playing) this.request = requestAnimationFrame((next) => this.tick(next));
  }

  restyle() {
    this.readColours(this.root);
    this.swatches.forEach((canvas, kind) => this.drawSwatch(canvas, kind));
    this.panel.map.prepare();
    this.draw();
  }

  resize() {
    this.panel.map.prepare();
    if (this.trace.width) this.fit(this.stage.clientWidth || 400);
    this.draw();
  }

  draw() {
    this.drawn += 1;
    const { trace } = this, frame = Math.floor(this.at), now = performance.now();
    const round = Math.min(frame * trace.every, trace.rounds), words = `${round} / ${trace.rounds}`;
    if (this.clock.textContent !== words) {
      this.clock.textContent = words;
      this.slider.value = frame;
      this.slider.setAttribute("aria-valuetext", `round ${round} of ${trace.rounds}`);
    }
    if (trace.width && this.view) this.drawField();
    if (this.playing && now - this.panelAt <= PANEL_MS) return;
    this.panelAt = now;
    this.panel.draw();
    if (trace.width) this.canvas.setAttribute("aria-label", this.description());
  }
}

function button(label, picture, onclick) {
  return h("button", { class: "zp-button", type: "button", "aria-label": label, title: label,
    onclick }, icon(picture));
}

function icon(name) {
  return s("svg", { viewBox: "0 0 16 16", class: "zp-icon", "aria-hidden": "true" },
    s("path", { d: ICONS[name] }));
}

function select(label, options, choose) {
  const made = h("select", {
    class: "zp-select", "aria-label": label,
    onchange: (event) => choose(Number(event.target.value)) });
  fill(made, ...options.map(([value, text]) => h("option", { value: String(value), text })));
  return made;
}

function shown(value) {
  if (value === null) return "none";
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(6)));
}
