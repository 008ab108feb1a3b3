// The numbers of the chosen agent: what it observes and sets, and its hidden neurons.
import { h } from "./elements.js";

const STRIP = 6; // pixels of a number's row over the whole trial

export class Panel {
  constructor(picture) {
    const { trace } = picture;
    this.picture = picture;
    this.numbers = [];
    this.title = h("h3", { class: "zp-agent", text: "no agent chosen" });
    this.strips = h("canvas", {
      class: "zp-strips", role: "img",
      "aria-label": "all numbers of the agent over the whole trial, a row each" });
    const tables = [
      ["inputs", "observes", trace.sensors], ["hidden", "hidden neurons", trace.neurons],
      ["outputs", "sets", trace.actuators]].filter(([track]) => trace.tracks[track]);
    const table = ([track, title, names]) => [
      h("h4", { class: "zp-what", text: title }),
      h("div", { class: "zp-numbers", role: "group", "aria-label": title },
        // it scrolls: Tab reaches it
        ...names.flatMap((name, number) => this.row(track, name, number))),
    ];
    this.element = h("div", { class: "zp-panel", role: "region",
      "aria-label": "numbers of the agent" },
      this.title, ...tables.flatMap(table), this.strips);
    this.element.hidden = this.numbers.length === 0;
  }

  row(track, name, number) {
    const value = h("span", { class: "zp-value" }), bar = h("span", { class: "zp-amount" });
    this.numbers.push({ track, number, value, bar });
    return [h("span", { class: "zp-name", text: name, title: name }),
      h("span", { class: "zp-rail", "aria-hidden": "true" }, bar), value];
  }

  /** Call a function with the place of each number and its value in a frame, null for none. */
  each(frame, use) {
    const read = {};
    this.numbers.forEach((one, row) => {
      read[one.track] ??= this.picture.numbersAt(one.track, frame) ?? (() => null);
      use(one, read[one.track](one.number), row);
    });
  }

  draw() {
    const { picture } = this;
    this.each(Math.floor(picture.at), ({ track, number, value, bar }, now) => {
      const { low, high } = picture.trace.tracks[track];
      value.textContent = now === null ? "–" : now.toFixed(Math.abs(now) >= 100 ? 0 : 2);
      const least = Math.min(low[number], 0),
        span = Math.max(high[number], 0, least + 1e-9) - least;
      bar.style.left = `${(100 * (Math.min(now, 0) - least)) / span}%`;
      bar.style.width = `${100 * Math.min(Math.abs(now) / span, 1)}%`;
    });
    if (!this.image) return;
    const context = this.strips.getContext("2d"), { width, height } = this.strips;
    context.drawImage(this.image, 0, 0);
    context.fillStyle = picture.colours.fg;
    context.fillRect((picture.at / Math.max(1, picture.last)) * (width - 2), 0, 2, height);
  }

  /** Draw all numbers over the trial, low ones dark and high ones bright; once for each agent. */
  drawStrips() {
    const { colours, chosen, last, trace } = this.picture;
    this.image = undefined;
    this.strips.hidden = chosen < 0 || !this.numbers.length;
    if (this.strips.hidden || !colours) return;
    const width = Math.max(60, Math.round(this.strips.clientWidth || 240)),
      height = this.numbers.length * STRIP;
    Object.assign(this.strips, { width, height });
    this.image = h("canvas", { width, height });
    const context = this.image.getContext("2d"), columns = Math.min(width, last),
      wide = width / Math.max(1, columns);
    context.fillStyle = colours.field;
    context.fillRect(0, 0, width, height);
    context.fillStyle = colours.accent;
    for (let column = 0; column < columns; column += 1) {
      this.each(Math.floor((column / columns) * last), ({ track, number }, value, row) => {
        if (value === null) return;
        const { low, high } = trace.tracks[track];
        context.globalAlpha = 0.05 + 0.95 * ((value - low[number]) / (high[number] - low[number]
          || 1));
        context.fillRect(column * wide, row * STRIP, wide + 0.5, STRIP - 1);
      });
    }
  }
}
