// Curves as SVG: lines, bands, a cursor that a pointer or the keyboard moves, and a zoom.
import { button, duration, fill, h, number, s, save, setText } from './page.js';

const DASHES = [null, '7 4', '2 3', '10 3 2 3'];
const LEFT = 62, RIGHT = 12, TOP = 8, BOTTOM = 34; // pixels around the curves
const DRAGGED = 8; // pixels from which on a drag is a zoom
const SAVED = 2400; // pixels of a saved picture's width
const STYLES = ['color', 'fill', 'stroke', 'stroke-width', 'opacity', 'font-size', 'font-family'];

export class Chart {
  // options: label (what it is), height, time (x is seconds), xLabel, hint, onpick(x)
  constructor(options) {
    this.options = options;
    this.series = [];
    this.hidden = new Set();
    this.view = null; // [from, to] of x; null: all
    this.cursor = null;
    this.axes = s('g', { class: 'axes' });
    this.lines = s('g');
    this.marks = s('g');
    this.plot = s('svg', { x: LEFT }, this.lines, this.marks); // it clips
    this.svg = s('svg', {
      tabindex: 0, role: 'img', 'aria-label': options.label,
      onpointermove: (event) => this.move(event),
      onpointerdown: (event) => this.press(event),
      onpointerup: (event) => this.release(event),
      onpointerleave: () => { if (this.from === undefined) this.point(null); },
      ondblclick: () => this.look(null),
      onkeydown: (event) => this.key(event),
    }, this.axes, this.plot);
    this.legend = h('div', { class: 'legend' });
    this.readout = h('p', { class: 'readout', 'aria-live': 'polite' });
    this.whole = button('show all', () => this.look(null), { class: 'small', hidden: true });
    this.element = h('figure', { class: 'chart' }, this.legend, this.svg,
      h('div', { class: 'under' }, this.readout, this.whole));
    new ResizeObserver(() => this.redraw()).observe(this.element);
  }

  // Each: name, x, y, or low and high (a band); maybe steps, thin, dash, ink (a CSS
  // property), and unnamed: the legend leaves it out.
  set(series, changes = {}) {
    Object.assign(this.options, changes);
    this.series = series.map((one, i) => ({
      ink: `--c${(i % 7) + 1}`, dash: DASHES[i % DASHES.length], ...one }));
    const names = series.map((one) => one.name).join('\n');
    if (names !== this.names) this.showLegend();
    this.names = names;
    this.redraw();
  }

  showLegend() {
    fill(this.legend, ...this.series.filter((one) => !one.unnamed).map((one) => {
      const sample = s('svg', { class: 'sample', 'aria-hidden': 'true' },
        drawn(one, one.y ? 'M0 6H28' : 'M0 1H28V11H0Z'));
      const key = h('button', { type: 'button', class: 'key', 'aria-pressed': 'true' },
        sample, h('span', { text: one.name }));
      key.addEventListener('click', () => {
        if (!this.hidden.delete(one.name)) this.hidden.add(one.name);
        key.setAttribute('aria-pressed', String(!this.hidden.has(one.name)));
        this.redraw();
      });
      return key;
    }));
  }

  look(view) {
    this.view = view;
    this.whole.hidden = view === null;
    this.redraw();
  }

  redraw() {
    this.waiting ??= requestAnimationFrame(() => { this.waiting = null; this.draw(); });
  }

  shown() {
    return this.series.filter((one) => !this.hidden.has(one.name));
  }

  // Return the ends of x and y.
  range() {
    const shown = this.shown();
    let [left, right] = this.view ?? ends(shown.flatMap(({ x }) => [x[0], x.at(-1)]));
    if (left === right) right = left + 1;
    const inside = ({ x, y, low, high }) => [y, low, high].flatMap((values) => (
      values?.filter((_, i) => x[i] >= left && x[i] <= right) ?? []));
    let [low, high] = ends(shown.flatMap(inside));
    const pad = low === high ? Math.abs(low) * 0.1 || 1 : (high - low) * 0.04;
    return [left, right, low - pad, high + pad];
  }

  draw() {
    const width = this.element.clientWidth, { height } = this.options;
    if (!width) return;
    const [left, right, low, high] = this.range();
    const wide = width - LEFT - RIGHT, tall = height - TOP - BOTTOM;
    this.toX = (x) => (x - left) / (right - left) * wide;
    const bend = this.options.log ? Math.asinh : (y) => y, [from, to] = [bend(low), bend(high)];
    this.toY = (y) => TOP + (to - bend(y)) / (to - from) * tall;
    this.toValue = (at) => left + at / wide * (right - left);
    this.svg.setAttribute('viewBox', `0 0 ${width} ${height}`);
    this.plot.setAttribute('width', wide);
    this.plot.setAttribute('height', TOP + tall);
    this.drawAxes(low, high, left, right, width, height);
    fill(this.lines, ...this.shown().map((one) => drawn(one,
      one.y ? this.line(one) : this.band(one))));
    this.drawMarks();
    if (this.series.some((one) => one.x.length > 1)) performance.mark('curve');
  }

  drawAxes(low, high, left, right, width, height) {
    const { time, xLabel } = this.options, bottom = height - BOTTOM, parts = [];
    const rows = height / 55;
    for (const tick of this.options.log ? this.powers(low, high) : ticks(low, high, rows)) {
      const y = Math.round(this.toY(tick)) + 0.5;
      parts.push(s('path', { d: `M${LEFT} ${y}H${width - RIGHT}` }),
        s('text', { x: LEFT - 7, y: y + 4, 'text-anchor': 'end', text: number(tick, 4) }));
    }
    for (const tick of ticks(left, right, width / 110, time ? 0 : 1)) {
      const x = Math.round(LEFT + this.toX(tick)) + 0.5;
      const anchor = x > width - 40 ? 'end' : 'middle';
      parts.push(s('path', { d: `M${x} ${bottom}v4` }), s('text', {
        x: anchor === 'end' ? width : x, y: bottom + 16, 'text-anchor': anchor,
        text: time ? duration(tick) : number(tick, 6) }));
    }
    fill(this.axes, ...parts, s('text', {
      x: (LEFT + width) / 2, y: height - 4, 'text-anchor': 'middle', text: xLabel }));
  }

  // Return 0 and powers of ten of both signs, as far as their labels have room.
  powers(low, high) {
    const all = Array.from({ length: 31 }, (_, i) => 10 ** i);
    const found = [0, ...all, ...all.map((one) => -one)].filter((y) => y >= low && y <= high);
    const kept = [];
    for (const y of found.sort((a, b) => Math.abs(b) - Math.abs(a))) {
      if (kept.every((other) => Math.abs(this.toY(other) - this.toY(y)) > 16)) kept.push(y);
    }
    return kept.length > 1 ? kept : ticks(low, high, 4);
  }

  line({ x, y, steps }) {
    let path = '', down = false;
    x.forEach((at, i) => {
      const known = y[i] !== null && y[i] !== undefined;
      const [px, py] = [this.toX(at).toFixed(1), known && this.toY(y[i]).toFixed(1)];
      if (known) path += !down ? `M${px} ${py}h0` : steps ? `H${px}V${py}` : `L${px} ${py}`;
      down = known;
    });
    return path;
  }

  band({ x, low, high }) {
    const known = x.map((_, i) => i).filter((i) => low[i] !== null && high[i] !== null);
    const points = (ys) => known.map((i) => (
      `${this.toX(x[i]).toFixed(1)} ${this.toY(ys[i]).toFixed(1)}`));
    return known.length > 1 ? `M${[...points(high), ...points(low).reverse()].join('L')}Z` : '';
  }

  // Draw the cursor and the part that is being chosen, and write what is at the cursor.
  drawMarks() {
    if (!this.toX) return;
    const { cursor, from, to } = this, { hint, height, time, xLabel } = this.options;
    const chosen = to === undefined ? null : s('rect', {
      class: 'chosen', x: Math.min(from, to), width: Math.abs(to - from), height });
    const read = cursor === null ? [] : this.shown()
      .filter(({ x, y }) => y && x[0] <= cursor && cursor <= x.at(-1))
      .map((one) => ({ ...one, at: nearest(one.x, cursor) }))
      .filter(({ at, y }) => (y[at] ?? null) !== null);
    fill(this.marks, chosen,
      cursor === null ? null : s('path',
        { class: 'cursor', d: `M${this.toX(cursor)} 0V${height}` }),
      ...read.map((one) => {
        const dot = s('circle', { class: 'dot', r: 4, cx: this.toX(one.x[one.at]),
          cy: this.toY(one.y[one.at]) });
        dot.style.color = `var(${one.ink})`;
        return dot;
      }));
    const words = read.slice(0, 8).map(({ name, y, at }) => `${name} ${number(y[at])}`);
    setText(this.readout, cursor === null ? hint ?? ''
      : `${xLabel ?? ''} ${time ? duration(cursor) : number(cursor)}: ${words.join(', ')}`);
  }

  // ---- pointer and keyboard

  point(cursor) {
    this.cursor = cursor;
    this.drawMarks();
  }

  place(event) {
    return event.clientX - this.svg.getBoundingClientRect().left - LEFT;
  }

  // Return the x of a point that is nearest to a place.
  snap(place) {
    const value = this.toValue(place), away = (x) => Math.abs(x - value);
    const near = this.shown().filter(({ x }) => x.length).map(({ x }) => x[nearest(x, value)]);
    return near.reduce((best, x) => (best === null || away(x) < away(best) ? x : best), null);
  }

  move(event) {
    if (!this.toValue) return;
    if (this.from !== undefined) this.to = this.place(event);
    this.point(this.snap(this.place(event)));
  }

  press(event) {
    this.from = this.place(event);
    this.svg.setPointerCapture(event.pointerId);
  }

  release(event) {
    const { from, to } = this, picked = this.snap(this.place(event));
    this.from = this.to = undefined;
    if (to !== undefined && Math.abs(to - from) > DRAGGED) {
      this.look([from, to].map((at) => this.toValue(at)).sort((a, b) => a - b));
    } else if (picked !== null) {
      this.options.onpick?.(picked);
    }
    this.drawMarks();
  }

  key(event) {
    const xs = this.shown().reduce((most, { x }) => (x.length > most.length ? x : most), []);
    if (!xs.length) return;
    const last = xs.length - 1, at = this.cursor === null ? last : nearest(xs, this.cursor);
    const step = event.shiftKey ? Math.max(1, Math.round(xs.length / 20)) : 1;
    const moved = { ArrowLeft: Math.max(0, at - step), ArrowRight: Math.min(last, at + step),
      Home: 0, End: last };
    if (event.key in moved) this.point(xs[moved[event.key]]);
    else if (event.key === 'Enter' && this.cursor !== null) this.options.onpick?.(this.cursor);
    else if (event.key === 'Escape') { this.point(null); this.look(null); } else return;
    event.preventDefault();
  }

  async png(name) {
    this.point(null);
    const copy = this.svg.cloneNode(true), originals = this.svg.querySelectorAll('*');
    copy.querySelectorAll('*').forEach((one, i) => {
      const style = getComputedStyle(originals[i]);
      one.removeAttribute('style');
      for (const key of STYLES) one.setAttribute(key, style[key]);
    });
    const { width, height } = this.svg.viewBox.baseVal, scale = SAVED / width;
    copy.setAttribute('width', width * scale);
    copy.setAttribute('height', height * scale);
    const image = new Image();
    const text = new XMLSerializer().serializeToString(copy);
    image.src = `data:image/svg+xml,${encodeURIComponent(text)}`;
    await image.decode();
    const canvas = h('canvas', { width: SAVED, height: (height + 30) * scale });
    const pen = canvas.getContext('2d'), body = getComputedStyle(this.element.closest('.card'));
    pen.fillStyle = body.backgroundColor;
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(image, 0, 30 * scale);
    pen.scale(scale, scale);
    pen.font = '12px system-ui, sans-serif';
    let at = LEFT;
    for (const key of this.legend.querySelectorAll('[aria-pressed=true]')) {
      const path = key.querySelector('path');
      pen.fillStyle = getComputedStyle(path).color;
      pen.fillRect(at, 12, 22, path.classList.contains('line') ? 3 : 8);
      pen.fillStyle = body.color;
      pen.fillText(key.textContent, at + 28, 18);
      at += 50 + pen.measureText(key.textContent).width;
    }
    save(await new Promise((done) => { canvas.toBlob(done); }), name);
  }
}

// Make the path of a line or a band.
function drawn({ y, x, ink, dash, thin }, d) {
  const kind = y ? `line${thin ? ' thin' : ''}${x.length === 1 ? ' single' : ''}` : 'band';
  const path = s('path', { d, class: kind, 'stroke-dasharray': y ? dash : null });
  path.style.color = `var(${ink})`;
  return path;
}

// Return the least and the greatest number; 0 and 1 without any.
function ends(values) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    if (value === null || value === undefined) continue;
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  return low <= high ? [low, high] : [0, 1];
}

function ticks(low, high, wanted, least = 0) {
  const raw = (high - low) / Math.max(2, wanted), power = 10 ** Math.floor(Math.log10(raw));
  const round = [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= raw) ?? raw;
  const step = Math.max(least, round), first = Math.ceil(low / step);
  const count = Math.floor(high / step + 1e-9) - first + 1;
  return Array.from({ length: Math.max(0, count) }, (_, i) => (first + i) * step);
}

// Return the index of the nearest of sorted numbers, -1 without any.
export function nearest(sorted, value) {
  let [low, high] = [0, sorted.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < value) low = middle; else high = middle;
  }
  return Math.abs(sorted[low] - value) <= Math.abs(sorted[high] - value) ? low : high;
}
