// When the slots of each server computed: a row per server, with signs for its events.
import { clock, duration, fill, h, number, s, setText } from './page.js';

export class Timeline {
  constructor() {
    this.readout = h('p', { class: 'readout', 'aria-live': 'polite' });
    this.rows = h('div', { class: 'timeline', role: 'img',
      'aria-label': 'When the slots of each server computed' });
    this.element = h('figure', { class: 'chart' }, this.rows,
      h('div', { class: 'under' }, this.readout));
  }

  set({ begin, busy, end, events, slots }) {
    const names = Object.keys(busy).sort((a, b) => a.localeCompare(b, 'en', { numeric: true }));
    const left = (at) => `${100 * (at - begin) / (end - begin)}%`;
    const signs = (server) => events.filter((one) => one.server === server).map(({ at, level,
      sign }) => {
      const element = h('i', { class: sign ? level : 'began', text: sign });
      element.style.left = left(at);
      return element;
    });
    const lane = (name) => {
      const bins = busy[name], most = slots[name] ?? 1;
      const draw = s('svg', { viewBox: `0 0 ${bins.length} 1`, preserveAspectRatio: 'none' },
        s('path', { d: bars(bins, most) }));
      return h('div', { class: 'lane', onpointermove: (event) => {
        const { left: edge, width } = draw.getBoundingClientRect();
        const bin = Math.min(bins.length - 1,
          Math.floor((event.clientX - edge) / width * bins.length));
        const at = clock(begin + (end - begin) * bin / bins.length);
        if (bin >= 0) setText(this.readout,
          `${name}, ${at}: ${number(bins[bin], 3)} of ${number(most)} slots computed`);
      } }, draw, ...signs(name), ...signs(''));
    };
    const shares = [1, 0.75, 0.5, 0.25].map((share) => `−${duration((end - begin) * share)}`);
    fill(this.rows, ...names.flatMap((name) => [h('span', { text: name, title: name }),
      lane(name)]),
      h('span'), h('div', { class: 'ends' },
        ...(names.length ? [...shares, clock(end)] : []).map((text) => h('span', { text }))));
  }
}

// Return a path of bars in a box as wide as their number and 1 high.
export function bars(values, most, wide = 1) {
  return values.map((value, i) => value > 0
    && `M${i} 1v${-Math.min(1, value / most)}h${wide}V1z`).filter(Boolean).join('');
}
