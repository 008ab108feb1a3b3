// Curves on a canvas: lines, bands, a cursor that a pointer or the keyboard moves, and a part to look at closely.
import { colour, duration, fill, h, number, save, setText } from './page.js';

const DASHES = [[], [7, 4], [2, 3], [10, 3, 2, 3]];
const LEFT = 62;
const BOTTOM = 34;
const TOP = 8;
const RIGHT = 12;

export class Chart {
  // options: label (what it is), height, time (x is seconds), xLabel, onpick(x)
  constructor(options) {
    this.options = options;
    this.series = [];
    this.hidden = new Set();
    this.view = null; // [from, to] of x that is looked at; null: all
    this.cursor = null;
    this.drag = null;
    this.canvas = h('canvas', { tabindex: 0, role: 'img', 'aria-label': options.label });
    this.legend = h('div', { class: 'legend' });
    this.readout = h('p', { class: 'readout', 'aria-live': 'polite' });
    this.whole = h('button', { type: 'button', class: 'small', text: 'show all', hidden: true, onclick: () => this.look(null) });
    this.element = h('figure', { class: 'chart' }, this.legend, this.canvas, h('div', { class: 'under' }, this.readout, this.whole));
    new ResizeObserver(() => this.redraw()).observe(this.element);
    window.addEventListener('recolour', () => this.redraw());
    this.canvas.addEventListener('pointermove', (event) => this.point(event));
    this.canvas.addEventListener('pointerdown', (event) => this.press(event));
    this.canvas.addEventListener('pointerup', (event) => this.release(event));
    this.canvas.addEventListener('pointerleave', () => { if (!this.drag) { this.cursor = null; this.redraw(); } });
    this.canvas.addEventListener('dblclick', () => this.look(null));
    this.canvas.addEventListener('keydown', (event) => this.key(event));
  }

  // Each: name, x, y, and maybe low and high (a band), colour (a custom property), dash, thin, of (what a band belongs to).
  set(series, changes = {}) {
    Object.assign(this.options, changes);
    const names = series.map((one) => one.name).join('\n');
    this.series = series;
    if (names !== this.names) {
      this.names = names;
      this.showLegend();
    }
    this.redraw();
  }

  showLegend() {
    fill(this.legend, ...this.series.map((one, index) => {
      const sample = h('canvas', { class: 'sample', width: 28, height: 12, 'aria-hidden': 'true' });
      const button = h('button', { type: 'button', class: 'key', 'aria-pressed': 'true', onclick: () => {
        if (!this.hidden.delete(one.name)) this.hidden.add(one.name);
        button.setAttribute('aria-pressed', String(!this.hidden.has(one.name)));
        this.redraw();
      } }, sample, h('span', { text: one.name }));
      const paint = () => {
        const pen = sample.getContext('2d');
        pen.clearRect(0, 0, 28, 12);
        if (one.y) {
          pen.strokeStyle = colour(this.ink(one, index));
          pen.lineWidth = 2;
          pen.setLineDash(one.dash ?? DASHES[index % DASHES.length]);
          pen.beginPath();
          pen.moveTo(0, 6);
          pen.lineTo(28, 6);
          pen.stroke();
        } else {
          pen.globalAlpha = 0.3;
          pen.fillStyle = colour(this.ink(one, index));
          pen.fillRect(0, 1, 28, 10);
          pen.globalAlpha = 1;
        }
      };
      paint();
      window.addEventListener('recolour', paint);
      return button;
    }));
  }

  ink(one, index) {
    return one.colour ?? `--c${(index % 7) + 1}`;
  }

  look(view) {
    this.view = view;
    this.whole.hidden = view === null;
    this.redraw();
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }

  shown() {
    return this.series.map((one, index) => ({ ...one, index })).filter((one) => !this.hidden.has(one.name));
  }

  range(shown) {
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const one of shown) for (const x of [one.x[0], one.x[one.x.length - 1]]) if (x !== undefined) { left = Math.min(left, x); right = Math.max(right, x); }
    if (this.view) [left, right] = this.view;
    for (const one of shown) for (const values of [one.y, one.low, one.high]) {
      if (!values) continue;
      for (let i = 0; i < values.length; i += 1) {
        if (values[i] === null || one.x[i] < left || one.x[i] > right) continue;
        low = Math.min(low, values[i]);
        high = Math.max(high, values[i]);
      }
    }
    if (!(left <= right)) [left, right] = [0, 1];
    if (left === right) right = left + 1;
    if (!(low <= high)) [low, high] = [0, 1];
    if (low === high) { const pad = Math.abs(low) * 0.1 || 1; low -= pad; high += pad; }
    const pad = (high - low) * 0.04;
    return [left, right, low - pad, high + pad];
  }

  draw() {
    const width = this.element.clientWidth;
    if (!width) return;
    const height = this.options.height ?? 260;
    const scale = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(width * scale);
    this.canvas.height = Math.round(height * scale);
    this.canvas.style.height = `${height}px`;
    const pen = this.canvas.getContext('2d');
    pen.scale(scale, scale);
    this.paint(pen, width, height);
    window.__zswarm.frames += 1;
    if (!window.__zswarm.firstCurve && this.series.some((one) => one.x.length > 1)) window.__zswarm.firstCurve = performance.now();
  }

  paint(pen, width, height) {
    const shown = this.shown();
    const [left, right, low, high] = this.range(shown);
    const toX = (x) => LEFT + (x - left) / (right - left) * (width - LEFT - RIGHT);
    const toY = (y) => height - BOTTOM - (y - low) / (high - low) * (height - TOP - BOTTOM);
    this.toValue = (at) => left + (at - LEFT) / (width - LEFT - RIGHT) * (right - left);
    pen.font = '12px system-ui, sans-serif';
    pen.lineWidth = 1;
    pen.textBaseline = 'middle';
    pen.textAlign = 'right';
    for (const tick of ticks(low, high, Math.max(2, height / 55))) {
      pen.strokeStyle = colour('--line');
      line(pen, LEFT, toY(tick), width - RIGHT, toY(tick));
      pen.fillStyle = colour('--dim');
      pen.fillText(number(tick, 4), LEFT - 7, toY(tick));
    }
    pen.textBaseline = 'top';
    pen.textAlign = 'center';
    const time = this.options.time;
    for (const tick of ticks(left, right, Math.max(2, width / 110), time ? 0 : 1)) {
      pen.strokeStyle = colour('--line');
      line(pen, toX(tick), height - BOTTOM, toX(tick), height - BOTTOM + 4);
      pen.fillStyle = colour('--dim');
      const text = time ? duration(tick) : number(tick, 6);
      const half = pen.measureText(text).width / 2;
      pen.fillText(text, Math.min(width - half - 2, Math.max(half + 2, toX(tick))), height - BOTTOM + 6);
    }
    pen.fillText(this.options.xLabel ?? '', LEFT + (width - LEFT - RIGHT) / 2, height - 14);
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM + 1);
    pen.clip();
    for (const one of shown) if (one.low) band(pen, one, toX, toY, colour(this.ink(one, one.index)));
    for (const one of shown) {
      if (!one.y) continue;
      pen.strokeStyle = colour(this.ink(one, one.index));
      pen.lineWidth = one.thin ? 1.2 : 2;
      pen.setLineDash(one.dash ?? DASHES[one.index % DASHES.length]);
      curve(pen, one, toX, toY);
    }
    pen.setLineDash([]);
    if (this.drag && this.drag.to !== undefined) {
      pen.fillStyle = colour('--accent');
      pen.globalAlpha = 0.15;
      pen.fillRect(Math.min(this.drag.from, this.drag.to), 0, Math.abs(this.drag.to - this.drag.from), height - BOTTOM);
      pen.globalAlpha = 1;
    }
    if (this.cursor !== null) {
      pen.strokeStyle = colour('--dim');
      pen.lineWidth = 1;
      line(pen, toX(this.cursor), 0, toX(this.cursor), height - BOTTOM);
      for (const one of shown) {
        const at = nearest(one.x, this.cursor);
        if (!one.y || at < 0 || one.y[at] === null) continue;
        pen.fillStyle = colour(this.ink(one, one.index));
        pen.beginPath();
        pen.arc(toX(one.x[at]), toY(one.y[at]), 4, 0, 2 * Math.PI);
        pen.fill();
      }
    }
    pen.restore();
    this.say(shown);
  }

  say(shown) {
    if (this.cursor === null) {
      setText(this.readout, this.options.hint ?? '');
      return;
    }
    const x = this.options.time ? duration(this.cursor) : number(this.cursor);
    const values = shown.filter((one) => one.y).map((one) => {
      const at = nearest(one.x, this.cursor);
      return at < 0 ? null : `${one.name} ${number(one.y[at])}`;
    });
    setText(this.readout, `${this.options.xLabel ?? ''} ${x}: ${values.filter(Boolean).slice(0, 8).join(', ')}`);
  }

  // ---- pointer and keyboard

  snap(value) {
    let found = null;
    for (const one of this.shown()) {
      const at = nearest(one.x, value);
      if (at >= 0 && (found === null || Math.abs(one.x[at] - value) < Math.abs(found - value))) found = one.x[at];
    }
    return found;
  }

  point(event) {
    if (!this.toValue) return;
    if (this.drag) this.drag.to = event.offsetX;
    this.cursor = this.snap(this.toValue(event.offsetX));
    this.redraw();
  }

  press(event) {
    this.drag = { from: event.offsetX };
    this.canvas.setPointerCapture(event.pointerId);
  }

  release(event) {
    const drag = this.drag;
    this.drag = null;
    if (drag && drag.to !== undefined && Math.abs(drag.to - drag.from) > 8) {
      this.look([drag.from, drag.to].map((at) => this.toValue(at)).sort((a, b) => a - b));
    } else if (this.options.onpick && this.toValue) {
      const picked = this.snap(this.toValue(event.offsetX));
      if (picked !== null) this.options.onpick(picked);
    }
    this.redraw();
  }

  key(event) {
    const xs = this.shown().reduce((most, one) => (one.x.length > most.length ? one.x : most), []);
    if (!xs.length) return;
    const at = this.cursor === null ? xs.length - 1 : nearest(xs, this.cursor);
    const step = event.shiftKey ? Math.max(1, Math.round(xs.length / 20)) : 1;
    const moved = { ArrowLeft: Math.max(0, at - step), ArrowRight: Math.min(xs.length - 1, at + step), Home: 0, End: xs.length - 1 }[event.key];
    if (moved !== undefined) this.cursor = xs[moved];
    else if (event.key === 'Enter' && this.cursor !== null && this.options.onpick) this.options.onpick(this.cursor);
    else if (event.key === 'Escape') { this.cursor = null; this.look(null); } else return;
    event.preventDefault();
    this.redraw();
  }

  async png(name) {
    const [width, height] = [1200, 600];
    const canvas = h('canvas', { width: 2 * width, height: 2 * height });
    const pen = canvas.getContext('2d');
    pen.scale(2, 2);
    pen.fillStyle = colour('--card');
    pen.fillRect(0, 0, width, height);
    pen.translate(0, 30);
    const cursor = this.cursor;
    this.cursor = null;
    this.paint(pen, width, height - 30);
    this.cursor = cursor;
    pen.textAlign = 'left';
    pen.textBaseline = 'middle';
    let at = LEFT;
    for (const one of this.shown()) {
      pen.fillStyle = colour(this.ink(one, one.index));
      pen.fillRect(at, -18, 22, one.y ? 3 : 8);
      pen.fillStyle = colour('--fg');
      pen.fillText(one.name, at + 28, -16);
      at += 50 + pen.measureText(one.name).width;
    }
    this.redraw();
    save(await new Promise((done) => canvas.toBlob(done)), name);
  }
}

export function ticks(low, high, wanted, least = 0) {
  const raw = (high - low) / wanted;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = Math.max(least, [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= raw) ?? raw);
  const found = [];
  for (let tick = Math.ceil(low / step) * step; tick <= high + step * 1e-9; tick += step) found.push(Math.abs(tick) < step * 1e-9 ? 0 : tick);
  return found;
}

export function nearest(sorted, value) {
  if (!sorted.length) return -1;
  let [low, high] = [0, sorted.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < value) low = middle; else high = middle;
  }
  return Math.abs(sorted[low] - value) <= Math.abs(sorted[high] - value) ? low : high;
}

function line(pen, x1, y1, x2, y2) {
  pen.beginPath();
  pen.moveTo(Math.round(x1) + 0.5, Math.round(y1) + 0.5);
  pen.lineTo(Math.round(x2) + 0.5, Math.round(y2) + 0.5);
  pen.stroke();
}

function curve(pen, one, toX, toY) {
  pen.beginPath();
  let down = false;
  let points = 0;
  for (let i = 0; i < one.x.length; i += 1) {
    const y = one.y[i];
    if (y === null || y === undefined || one.x[i] === null) { down = false; continue; }
    if (down) {
      if (one.steps) pen.lineTo(toX(one.x[i]), toY(one.y[i - 1] ?? y));
      pen.lineTo(toX(one.x[i]), toY(y));
    } else pen.moveTo(toX(one.x[i]), toY(y));
    down = true;
    points += 1;
  }
  pen.stroke();
  if (points === 1) { // one point has no line
    const i = one.y.findIndex((value) => value !== null && value !== undefined);
    pen.beginPath();
    pen.arc(toX(one.x[i]), toY(one.y[i]), 3, 0, 2 * Math.PI);
    pen.fillStyle = pen.strokeStyle;
    pen.fill();
  }
}

function band(pen, one, toX, toY, ink) {
  const kept = one.x.map((x, i) => i).filter((i) => one.low[i] !== null && one.high[i] !== null);
  if (kept.length < 2) return;
  pen.globalAlpha = 0.18;
  pen.fillStyle = ink;
  pen.beginPath();
  for (const i of kept) pen.lineTo(toX(one.x[i]), toY(one.high[i]));
  for (const i of kept.reverse()) pen.lineTo(toX(one.x[i]), toY(one.low[i]));
  pen.closePath();
  pen.fill();
  pen.globalAlpha = 1;
}
