// All numbers of the chosen agent over the whole trial: a row for each, from left to right the rounds.
import { fill, h } from "./elements.js";

const ROW = 13; // pixels
const TICKS = 4; // of the axis, between which there are equal steps

export class HeatMap {
  constructor(picture, panel) {
    Object.assign(this, { picture, panel });
    this.canvas = h("canvas", { class: "zp-heat", role: "img", "aria-label":
      "heat map: the agent's numbers over the trial, a row each, rounds from left to right" });
    this.said = h("p", { class: "zp-pointed", "aria-live": "polite" });
    this.axis = h("div", { class: "zp-axis", "aria-hidden": "true" });
    this.names = h("div", { class: "zp-heat-names" });
    this.ends = h("div", { class: "zp-heat-names zp-heat-ends" });
    this.element = h("div", { class: "zp-heatmap" },
      h("h4", { class: "zp-what", text: "heat map of the whole trial" }),
      h("div", { class: "zp-heat-rows" }, this.names, this.canvas, this.ends),
      h("div", { class: "zp-heat-rows" }, h("span"), this.axis, h("span")),
      this.said,
      h("div", { class: "zp-scale" }, h("span", { text: "-max" }), h("span", { class: "zp-ramp" }),
        h("span", { text: "+max" }), h("span", { class: "zp-ramp-zero", text: "0" })),
      h("p", { class: "zp-dim zp-small", text: "Colour: the number, in its own unit. max is the "
        + "largest magnitude of a row, written to its right; grey: the agent did not act." }));
    for (const name of ["pointermove", "pointerdown"]) {
      this.canvas.addEventListener(name, (event) => this.point(event));
    }
    this.canvas.addEventListener("pointerleave", () => this.say(""));
  }

  /** Draw all rows; once for each agent. */
  prepare() {
    const { colours, chosen, trace } = this.picture, { numbers } = this.panel;
    this.image = undefined;
    this.element.hidden = chosen < 0 || !numbers.length;
    if (this.element.hidden || !colours) return;
    this.largest = numbers.map(({ low, high }) => Math.max(Math.abs(low), Math.abs(high)));
    if (!this.names.children.length) {
      fill(this.names, ...numbers.map(({ name }) => h("span", { text: name, title: name })));
      fill(this.ends, ...this.largest.map((most) => h("span", { text: String(Number(most.toPrecision(3))) })));
      this.fillAxis(trace.rounds);
    }
    const width = Math.max(60, Math.round(this.canvas.clientWidth || 160)),
      height = numbers.length * ROW;
    Object.assign(this.canvas, { width, height });
    this.canvas.style.height = `${height}px`;
    this.image = h("canvas", { width, height });
    this.paint(this.image.getContext("2d"), width, height);
  }

  paint(context, width, height) {
    const { colours, last, low, high } = this.picture, columns = Math.min(width, last),
      wide = width / Math.max(1, columns);
    context.fillStyle = colours.field;
    context.fillRect(0, 0, width, height);
    for (let column = 0; column < columns; column += 1) {
      this.panel.each(Math.floor((column / columns) * last), (_, value, row) => {
        context.fillStyle = value === null ? colours.edge : value < 0 ? low : high;
        context.globalAlpha = value === null ? 1
          : Math.min(1, Math.abs(value) / (this.largest[row] || 1));
        context.fillRect(column * wide, row * ROW, wide + 0.5, ROW - 1);
      });
    }
  }

  fillAxis(rounds) {
    const ticks = Array.from({ length: TICKS + 1 }, (_, i) => {
      const round = Math.round((i * rounds) / TICKS), tick = h("span", { text: String(round) });
      tick.style.left = `${(100 * round) / Math.max(1, rounds)}%`;
      return tick;
    });
    fill(this.axis, ...(rounds >= TICKS ? ticks : [ticks[0], ticks[TICKS]]),
      h("span", { class: "zp-axis-name", text: "round" }));
  }

  /** Draw the rows, and a line at the present round. */
  draw() {
    if (!this.image) return;
    const context = this.canvas.getContext("2d"), { width, height } = this.canvas,
      { at, last, colours } = this.picture;
    context.drawImage(this.image, 0, 0);
    context.fillStyle = colours.fg;
    context.fillRect((at / Math.max(1, last)) * (width - 2), 0, 2, height);
  }

  /** Say which number is where somebody points, and go there at a click. */
  point(event) {
    const box = this.canvas.getBoundingClientRect(), { picture, panel } = this;
    const share = Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1),
      row = Math.floor((event.clientY - box.top) / ROW);
    const frame = Math.min(Math.floor(share * picture.last), picture.last - 1);
    if (event.type === "pointerdown") picture.go(frame);
    panel.each(frame, ({ name }, value, number) => {
      if (number !== row) return;
      const words = value === null ? "does not act" : value.toPrecision(3);
      this.say(`round ${frame * picture.trace.every}, ${name}: ${words}`);
    });
  }

  say(text) {
    this.said.textContent = text;
  }
}
