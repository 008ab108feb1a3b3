// Plays traces (docs/replay.md) inside an element, of one run or of two side by side on one clock:
//
//   const player = await play(element, bytes);
//   player.pause(); player.frames; player.destroy();
//
// page.py puts this module and those it imports into one script.
import { fill, h, s } from "./elements.js";
import { Side } from "./side.js";
import { select } from "./view.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const SECONDS = 20, SLOWEST = 3,
  FASTEST = 500; // of a trial at speed 1; frames per second at least and at most
const PANEL_MS = 80; // between updates of the numbers
const ICONS = { // paths in a square of 16
  start: "M2 2h3v12H2zM14 2v12L5 8z", back: "M12 2v12L3 8z", play: "M4 2v12l10-6z",
  pause: "M3 2h4v12H3zM9 2h4v12H9z", ahead: "M3 2v12l8-6zM12 2h2v12h-2z",
};

/** Build a player.
 * @param {HTMLElement} element emptied, and filled with it
 * @param {Uint8Array|ArrayBuffer|Array} given bytes of a trace; or for each run `start`, the number
 *   of the trial to begin with, and `trials`, each with `generation`, `trial`, `fitness` and `load`,
 *   which returns the bytes of its trace
 * @returns {Promise<{pause: function, destroy: function, frames: number}>} frames: pictures drawn so far
 */
export async function play(element, given) {
  const alone = () => [{ start: 0, trials: [{ fitness: [], load: () => given }] }];
  const player = new Player(element, Array.isArray(given) ? given : alone());
  await player.begin();
  return {
    pause: () => player.pause(),
    destroy: () => player.destroy(),
    get frames() { return player.drawn; },
  };
}

class Player {
  constructor(element, runs) {
    Object.assign(this, { element, speed: 1, at: 0, playing: false, drawn: 0, panelAt: 0,
      trails: false, rays: true, last: 0 });
    this.still = window.matchMedia("(prefers-reduced-motion: reduce)");
    this.sides = runs.map((run, number) => new Side(run, number, this));
  }

  /** Show the first trials; nothing is built if one cannot be shown. */
  async begin() {
    await Promise.all(this.sides.map((side) => side.show(side.at)));
    this.build();
    this.listen();
    this.restyle();
    if (!this.still.matches) this.play();
  }

  get views() { return this.sides.map(({ view }) => view).filter(Boolean); }

  /** Take over the length of a trial that is shown now. */
  changed() {
    const traces = this.views.map(({ trace }) => trace), round = this.at * (this.every ?? 1);
    this.every = Math.min(...traces.map(({ every }) => every));
    this.rounds = Math.max(...traces.map(({ rounds }) => rounds));
    this.last = Math.ceil(this.rounds / this.every);
    this.perSecond = Math.min(Math.max(this.last / SECONDS, SLOWEST), FASTEST);
    this.at = Math.min(round / this.every, this.last);
    if (!this.root) return;
    this.slider.max = this.last;
    this.raysLabel.hidden = !this.hasRays();
    this.restyle();
  }

  build() {
    const parts = this.sides.flatMap(({ slots, menus }) => [slots.head, menus, slots.stage]);
    const below = this.sides.flatMap(({ slots }) => [slots.legend, slots.panel, slots.facts]);
    const two = this.sides.length > 1;
    this.root = h("section", { class: `zp ${two ? "zp-two" : "zp-one"}`,
      "aria-label": two ? "replay of two trials" : "replay of a trial" },
    h("div", { class: "zp-grid" }, ...parts, this.bar(), ...below));
    fill(this.element, this.root);
  }

  bar() {
    this.slider = h("input", {
      class: "zp-slider", "aria-label": "round", type: "range", min: 0, max: this.last, step: 1,
      value: 0,
      oninput: () => this.go(Number(this.slider.value)) });
    this.playButton = button("play", "play", () => this.toggle());
    this.clock = h("span", { class: "zp-clock" });
    this.speeds = select("speed", SPEEDS.map((speed) => [speed, `×${speed}`]),
      (value) => { this.speed = value; });
    this.speeds.value = 1;
    this.raysLabel = this.checkbox("sensors", "rays");
    this.raysLabel.hidden = !this.hasRays();
    return h("div", { class: "zp-bar", role: "group", "aria-label": "playing" },
      h("div", { class: "zp-line" },
        button("back to the start", "start", () => this.go(0)),
        button("a round back", "back", () => this.step(-1)),
        this.playButton, button("a round ahead", "ahead", () => this.step(1)), this.slider,
        this.clock),
      h("div", { class: "zp-line" }, this.speeds,
        this.views.some(({ trace }) => trace.width) && this.checkbox("trails", "trails"),
        this.raysLabel));
  }

  hasRays() { return this.views.some(({ trace }) => trace.rays?.length > 0); }

  checkbox(text, name) {
    this[`${name}Box`] = h("input", {
      type: "checkbox", checked: this[name],
      onchange: (event) => {
        this[name] = event.target.checked;
        for (const view of this.views) view[name] = this[name];
        this.draw();
      } });
    return h("label", { class: "zp-check" }, this[`${name}Box`], text);
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
    const dark = window.matchMedia("(prefers-color-scheme: dark)");
    for (const media of [dark, this.still]) listen(media, "change", () => this.restyle());
    listen(document, "visibilitychange", () => { this.before = undefined; });
    this.themes = new MutationObserver(() => this.restyle());
    this.themes.observe(documentElement, { attributes: true, attributeFilter: ["data-theme"] });
    this.sizes = new ResizeObserver(() => requestAnimationFrame(() => this.root.isConnected
      && this.views.forEach((view) => view.resize())));
    this.sizes.observe(this.root);
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select")) return;
    const on = event.target.closest("button, summary, input"),
      slider = event.target.closest(".zp-slider");
    const choose = (by) => this.views.forEach((view) => view.choose(view.chosen + by));
    const acts = {
      " ": () => !(on && !slider) && this.toggle(),
      ArrowLeft: () => !slider && this.step(event.shiftKey ? -10 : -1),
      ArrowRight: () => !slider && this.step(event.shiftKey ? 10 : 1),
      Home: () => this.go(0),
      End: () => this.go(this.last),
      "+": () => this.faster(1),
      "=": () => this.faster(1),
      "-": () => this.faster(-1),
      "[": () => choose(-1),
      "]": () => choose(1),
      ",": () => this.sides.forEach((side) => side.trial(-1)),
      ".": () => this.sides.forEach((side) => side.trial(1)),
      PageUp: () => this.sides.forEach((side) => side.generation(-1)),
      PageDown: () => this.sides.forEach((side) => side.generation(1)),
      t: () => this.trailsBox?.click(),
      s: () => this.hasRays() && this.raysBox.click(),
    };
    const act = acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (act && act() !== false) event.preventDefault();
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

  /** Go to a round. */
  goTo(round) {
    this.go(Math.min(round / this.every, this.last));
  }

  faster(by) {
    const at = Math.min(Math.max(SPEEDS.indexOf(this.speed) + by, 0), SPEEDS.length - 1);
    this.speed = SPEEDS[at];
    this.speeds.value = this.speed;
  }

  destroy() {
    this.playing = false;
    cancelAnimationFrame(this.request);
    this.abort.abort();
    this.themes.disconnect();
    this.sizes.disconnect();
    for (const view of this.views) view.destroy();
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
    for (const view of this.views) view.restyle();
    this.draw();
  }

  draw() {
    this.drawn += 1;
    const now = performance.now(), frame = Math.floor(this.at),
      numbers = !this.playing || now - this.panelAt > PANEL_MS;
    const round = Math.min(frame * this.every, this.rounds), words = `${round} / ${this.rounds}`;
    if (this.clock.textContent !== words) {
      this.clock.textContent = words;
      this.slider.value = frame;
      this.slider.setAttribute("aria-valuetext", `round ${round} of ${this.rounds}`);
    }
    if (numbers) this.panelAt = now;
    for (const view of this.views) view.show(this.at * this.every, numbers);
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
