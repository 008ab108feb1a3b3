// The servers of a run: what each does, how fast, why it is not used, and when its slots computed.
import { follow } from './live.js';
import { SortedTable, ago, api, ask, badge, between, card, choice, fill, h, n, number, row, run, s,
  section, setText, showError, throttled, tr, unlessGone } from './page.js';
import { Timeline, bars } from './timeline.js';

const SLOW_MS = 3000; // between requests for the timeline
const HEADS = [
  ['server', 'server'], ['state', 'state'], ['leased', 'leased', 'n'], ['slots', 'slots', 'n'],
  ['trials', 'trials', 'n'], ['share of work', 'share'], ['trials/s', 'rate', 'n'],
  ['last minute', ''], ['ms per trial', 'trial_ms', 'n'], ['last result', 'last_at', 'n'],
  ['faults', 'faults', 'n'], ['losses', 'losses', 'n'], ['why', 'why'],
];
const SIGNS = 'Full height: all slots of the server computed; empty: none did. '
  + '▷ joined, ◁ left, ✕ lost, ▲ fault; a line: the run began or continued.';

export async function show(view) {
  const page = new ClusterPage(view);
  follow(run, (message) => page.receive(message));
  await unlessGone(async () => {
    document.title = `Servers of ${(await ask(api('about'))).name} · zswarm`;
    await page.load(true);
  });
}

class ClusterPage {
  constructor(view) {
    this.servers = new Map();
    this.state = { status: 'reading' };
    this.seconds = 0;
    this.timeline = new Timeline();
    this.load = throttled(SLOW_MS, async () => {
      this.timeline.set(await ask(api('timeline', this.seconds ? { seconds: this.seconds } : {})));
    });
    this.status = h('span', {}, badge('reading'));
    this.summary = h('p', { class: 'dim' });
    this.table = new SortedTable('servers', HEADS, ['trials', -1], serverRow, '');
    const times = [[60, '1 min'], [600, '10 min'], [0, 'all recorded']];
    fill(view,
      section(row(h('h1', { text: 'Servers' }), this.status), this.summary,
        this.table.filter, this.table.element),
      card('When slots computed',
        between(h('p', { class: 'dim small', text: SIGNS }),
          choice('Time', times, this.seconds, (value) => {
            this.seconds = value;
            unlessGone(() => this.load(true));
          })),
        h('div', { class: 'scroll tall' }, this.timeline.element)));
  }

  receive({ hello, servers, state }) {
    if (hello) this.servers.clear();
    if (state) {
      this.state = state;
      fill(this.status, badge(state.status));
      if (state.error) showError(state.error);
    }
    for (const one of servers ?? []) this.servers.set(one.server, { id: one.server, ...one });
    if (!hello && !servers && !state) return;
    const all = [...this.servers.values()];
    this.table.show(all);
    const { running, slots, trial_rate: rate } = this.state;
    const computing = all.filter((one) => one.slots).length;
    const now = running
      ? `${number(computing)} compute with ${number(slots)} slots; ${number(rate)} trials/s`
      : 'the run is not in progress';
    setText(this.summary, all.length ? `${number(all.length)} seen; ${now}` : 'no server yet');
    unlessGone(() => this.load());
  }
}

function serverRow(one) {
  const most = Math.max(...one.spark), bar = h('i');
  bar.style.width = `${100 * one.share}%`;
  const share = `${(100 * one.share).toFixed(one.share < 0.0995 ? 1 : 0)} %`;
  const spark = s('svg', { class: 'spark', viewBox: `0 0 ${one.spark.length} 1`,
    preserveAspectRatio: 'none', 'aria-hidden': 'true' },
  s('path', { d: most ? bars(one.spark, most, 0.8) : '' }));
  return tr([one.server, 'name'],
    h('span', { class: `health ${one.health}`, text: one.state || '–' }),
    n(one.leased), n(one.slots), n(one.trials),
    h('td', {}, h('span', { class: 'bar' }, bar), h('span', { class: 'dim small', text: share })),
    n(one.rate, 4), spark, n(one.trial_ms, 3), h('td', { class: 'n' }, ago(one.last_at)),
    n(one.faults), n(one.losses), [one.why, 'why']);
}
