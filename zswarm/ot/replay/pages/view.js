// One trial of the player: its title, picture, legend and numbers. The player sets its time.
import { fill, h } from "./elements.js";
import { Panel } from "./panel.js";
import { Picture } from "./picture.js";

const KEYS = {
  space: "play, pause", "← →": "a round back, ahead; with shift ten", "Home End": "start, end",
  "+ −": "faster, slower", "[ ]": "the previous agent, the next one", "T, S": "trails, sensors",
  ", .": "the previous trial, the next one",
  "PageUp PageDown": "the previous generation, the next one",
};

export class View extends Picture {
  /** @param {object} slots elements that it fills: head, stage, legend, panel, facts */
  constructor(trace, slots, player) {
    super(trace);
    Object.assign(this, { slots, player });
    this.abort = new AbortController();
    this.canvas = h("canvas", { class: "zp-canvas", role: "img" });
    this.canvas.addEventListener("pointerdown", (event) => this.touch(event),
      { signal: this.abort.signal });
    this.panel = new Panel(this);
    this.agents = select("agent", [[-1, "no agent"],
      ...Array.from({ length: trace.agents }, (_, i) => [i, `agent ${i}`])],
    (value) => this.choose(value));
    this.agents.classList.add("zp-numbers-of");
    this.build();
  }

  build() {
    const { trace, slots } = this, { about, error, note } = trace;
    const parts = ["generation", "candidate", "trial"].filter((key) => about[key] !== undefined);
    const title = [about.run ?? about.simulator ?? "",
      ...parts.map((key) => `${key} ${about[key] + (key === "generation")}`)].join(" · ");
    const metrics = Object.entries(trace.metrics).map(([key, value]) => `${key} ${shown(value)}`);
    const result = [`fitness ${trace.fitness.map(shown).join(", ")}`, ...metrics].join(" · ");
    const notes = [note, error && `the trial failed: ${error}`].filter(Boolean);
    const why = trace.no_picture ? ` (${trace.no_picture})` : "";
    const rest = "what the agents observe and set is shown alone.";
    const missing = `This simulator draws no picture${why}: ${rest}`;
    this.ended = h("p", { class: "zp-ended" });
    fill(slots.head, h("h2", { class: "zp-title", text: title }),
      h("p", { class: "zp-result", text: result }),
      ...notes.map((text) => h("p", { class: "zp-note", text, role: "alert" })));
    fill(slots.stage, trace.width ? this.canvas : h("p", { class: "zp-dim", text: missing }));
    fill(slots.legend, this.ended, this.legend());
    fill(slots.panel, trace.agents > 0 && this.agents, this.panel.element);
    fill(slots.facts, this.facts());
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

  choose(agent) {
    if (!this.trace.agents || agent >= this.trace.agents || agent < -1) return;
    this.chosen = agent;
    this.agents.value = agent;
    this.panel.title.textContent = agent < 0 ? "no agent chosen" : `agent ${agent}`;
    this.panel.map.prepare();
    this.draw();
  }

  /** Show the state at a round, or the last one. */
  show(round, numbers) {
    const { trace } = this, over = round >= trace.rounds;
    this.at = over ? this.last : round / trace.every;
    const words = over ? `ended at round ${trace.rounds}`
      : `round ${Math.floor(this.at) * trace.every} of ${trace.rounds}`;
    if (this.ended.textContent !== words) this.ended.textContent = words;
    this.draw(numbers);
  }

  /** Go to a frame, and everything on the same clock with it. */
  go(frame) {
    this.player.goTo(frame * this.trace.every);
  }

  restyle() {
    this.readColours(this.slots.legend);
    this.swatches.forEach((canvas, kind) => this.drawSwatch(canvas, kind));
    this.resize();
  }

  resize() {
    this.panel.map.prepare();
    if (this.trace.width) this.fit(this.slots.stage.clientWidth || 400);
    this.draw();
  }

  draw(numbers = true) {
    if (this.trace.width && this.view && this.colours) this.drawField();
    if (!numbers) return;
    this.panel.draw();
    if (this.trace.width) this.canvas.setAttribute("aria-label", this.description());
  }

  destroy() {
    this.abort.abort();
    for (const slot of Object.values(this.slots)) fill(slot);
  }
}

export function select(label, options, choose) {
  const made = h("select", {
    class: "zp-select", "aria-label": label,
    onchange: (event) => choose(Number(event.target.value)) });
  fill(made, ...options.map(([value, text]) => h("option", { value: String(value), text })));
  return made;
}

/** Return a result in words. */
export function shown(value) {
  if (value === null) return "none";
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(6)));
}
