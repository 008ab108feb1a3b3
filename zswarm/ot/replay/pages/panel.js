// The numbers of the chosen agent: what it observes and sets, and its hidden neurons.
import { h } from "./elements.js";
import { HeatMap } from "./heatmap.js";

export class Panel {
  constructor(picture) {
    const { trace } = picture;
    this.picture = picture;
    this.numbers = [];
    this.title = h("h3", { class: "zp-agent", text: "no agent chosen" });
    const tables = [
      ["inputs", "observations", trace.sensors], ["hidden", "hidden neurons", trace.neurons],
      ["outputs", "actions", trace.actuators]].filter(([track]) => trace.tracks[track]);
    const table = ([track, title, names]) => [
      h("h4", { class: "zp-what", text: title }),
      h("div", { class: "zp-numbers", role: "group", "aria-label": title },
        // it scrolls: Tab reaches it
        ...names.flatMap((name, number) => this.row(track, name, number))),
    ];
    const made = tables.flatMap(table);
    this.map = new HeatMap(picture, this);
    this.element = h("div", { class: "zp-panel", role: "region",
      "aria-label": "numbers of the agent" }, this.title, ...made, this.map.element);
    this.element.hidden = this.numbers.length === 0;
  }

  /** Make the row of a number: its bar begins at zero, which a tick marks where it is in range. */
  row(track, name, number) {
    const value = h("span", { class: "zp-value" }), bar = h("span", { class: "zp-amount" });
    const { low, high } = this.picture.trace.tracks[track];
    const least = Math.min(low[number], 0), most = Math.max(high[number], 0, least + 1e-9);
    const tick = h("span", { class: "zp-zero" });
    tick.style.left = `${(100 * -least) / (most - least)}%`;
    const range = `${name}: ${short(low[number])} to ${short(high[number])} in this trial`;
    this.numbers.push({ track, number, name, value, bar, least, most, high: high[number],
      low: low[number] });
    return [h("span", { class: "zp-name", text: name, title: name }),
      h("span", { class: "zp-end", text: short(least) }),
      h("span", { class: "zp-rail", title: range, "aria-hidden": "true" }, bar, tick),
      h("span", { class: "zp-end", text: short(most) }), value];
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
    this.each(Math.floor(this.picture.at), ({ value, bar, least, most }, now) => {
      value.textContent = now === null ? "–"
        : now.toFixed(Math.abs(now) >= 100 ? 0 : 2).replace("-0.00", "0.00");
      const span = most - least;
      bar.style.left = `${(100 * (Math.min(now, 0) - least)) / span}%`;
      bar.style.width = `${100 * Math.min(Math.abs(now) / span, 1)}%`;
    });
    this.map.draw();
  }
}

/** Return a number in few letters. */
function short(value) {
  return Math.abs(value) < 1e-6 ? "0" : String(Number(value.toPrecision(2)));
}
