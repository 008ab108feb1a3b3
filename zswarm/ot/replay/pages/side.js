// One run of the player: its generations and trials, of which one trial is shown.
import { decode } from "./decode.js";
import { fill, h } from "./elements.js";
import { select, shown, View } from "./view.js";

export class Side {
  /** @param {{start: number, trials: Array}} run trials: generation, trial, fitness and load() */
  constructor(run, number, player) {
    Object.assign(this, { trials: run.trials, at: run.start, player });
    const slot = () => h("div");
    this.slots = { head: slot(), stage: slot(), legend: slot(), panel: slot(), facts: slot() };
    this.menus = h("div", { class: "zp-menus" });
    for (const [name, element] of Object.entries({ ...this.slots, menus: this.menus })) {
      element.style.gridArea = `${name}${number}`;
    }
    this.generations = [...new Set(this.trials.map(({ generation }) => generation))];
  }

  /** Decode a trial and show it; of several that are asked for meanwhile, the last one. */
  async show(at) {
    this.at = at;
    const trace = await decode(this.trials[at].load());
    if (this.at !== at) return;
    const chosen = this.view?.chosen ?? 0;
    this.view?.destroy();
    this.view = new View(trace, this.slots, this.player);
    Object.assign(this.view, { trails: this.player.trails, rays: this.player.rays });
    this.fillMenus();
    this.view.choose(Math.min(chosen, trace.agents - 1));
    this.player.changed(this);
  }

  /** Show a generation (a step of them), with the same trial, or the first. */
  generation(by) {
    const { generation, trial } = this.trials[this.at];
    const found = this.generations[this.generations.indexOf(generation) + by];
    if (found === undefined) return;
    const same = this.trials.findIndex((one) => one.generation === found && one.trial === trial);
    this.show(same < 0 ? this.trials.findIndex((one) => one.generation === found) : same);
  }

  /** Show another trial of the generation. */
  trial(by) {
    const at = this.at + by;
    if (this.trials[at]?.generation === this.trials[this.at].generation) this.show(at);
  }

  fillMenus() {
    const { generation } = this.trials[this.at];
    const siblings = this.trials.map((one, at) => ({ ...one, at }))
      .filter((one) => one.generation === generation);
    const key = `${siblings.length > 1 && generation}`;
    if (this.filled !== key) fill(this.menus, this.generationMenu(), trialMenu(this, siblings));
    this.filled = key;
    const count = this.generations.indexOf(generation);
    if (this.slider) {
      this.slider.value = count;
      const words = `generation ${generation + 1}`;
      this.slider.setAttribute("aria-valuetext", words);
      this.words.textContent = `${words} (${count + 1} of ${this.generations.length})`;
    }
    if (this.choice) this.choice.value = String(this.at);
    this.menus.hidden = !this.slider && !this.choice;
  }

  generationMenu() {
    const { generations } = this;
    if (generations.length < 2) return null;
    this.slider ??= h("input", { class: "zp-slider", type: "range", "aria-label": "generation",
      min: 0, max: generations.length - 1, step: 1,
      oninput: () => this.generation(this.slider.valueAsNumber
        - generations.indexOf(this.trials[this.at].generation)) });
    this.words ??= h("span", { class: "zp-words" });
    return h("div", { class: "zp-line" }, step("previous generation", "‹", () => this.generation(-1)),
      step("next generation", "›", () => this.generation(1)), this.slider, this.words);
  }
}

function trialMenu(side, siblings) {
  side.choice = undefined;
  if (siblings.length < 2) return null;
  const marks = rank(siblings);
  side.choice = select("trial", siblings.map(({ at, trial, fitness }) => [at,
    `trial ${trial}: fitness ${fitness.map(shown).join(", ")}${marks.get(at) ?? ""}`]),
  (at) => side.show(at));
  return h("div", { class: "zp-line" }, step("previous trial", "‹", () => side.trial(-1)),
    step("next trial", "›", () => side.trial(1)), side.choice);
}

/** Return words for the worst, the median and the best trial by the first participant's fitness. */
function rank(siblings) {
  const sorted = siblings.filter(({ fitness }) => fitness[0] !== null)
    .sort((one, other) => one.fitness[0] - other.fitness[0]);
  if (sorted.length < 3 || sorted[0].fitness[0] === sorted.at(-1).fitness[0]) return new Map();
  const middle = sorted[(sorted.length - 1) >> 1];
  return new Map([[middle.at, " (median)"], [sorted[0].at, " (worst)"],
    [sorted.at(-1).at, " (best)"]]);
}

function step(label, text, onclick) {
  return h("button", { class: "zp-button", type: "button", "aria-label": label, title: label,
    text, onclick });
}
