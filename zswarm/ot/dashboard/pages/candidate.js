// One candidate: its genome, its network, what it did in each trial, and the replay of one.
import { follow } from './live.js';
import { drawNetwork } from './network.js';
import { address, api, ask, button, card, copyButton, fill, h, n, note, number, query, request, row,
  run, save, section, setText, table, two, unitOf } from './page.js';

const HEX = 8000; // digits of a genome that are shown

export async function show(view) {
  const page = new CandidatePage(view, await ask(api('about')), await ask(api('champions')));
  follow(run, ({ state }) => { if (state) page.finished = state.generation ?? page.finished; });
  const given = (name, otherwise) => (query.has(name) ? Number(query.get(name)) : otherwise);
  await page.go(given('generation', page.champions.at(-1)?.generation ?? 0),
    given('candidate', null));
}

class CandidatePage {
  constructor(view, about, champions) {
    Object.assign(this, { about, champions, finished: 0, player: null });
    document.title = `Candidate of ${about.name} · zswarm`;
    this.generation = h('input', {
      type: 'number', min: 1, step: 1, 'aria-label': 'generation',
      onchange: () => this.go(Math.max(0, Number(this.generation.value) - 1), null) });
    this.among = h('select', {
      'aria-label': 'candidate',
      onchange: () => this.go(this.at.generation, Number(this.among.value)) });
    this.facts = h('p', { class: 'dim' });
    this.readout = h('p', { class: 'readout', 'aria-live': 'polite' });
    for (const name of ['network', 'genome', 'trials', 'replay']) this[name] = h('div');
    fill(view,
      section(h('h1', { text: about.name }),
        row(h('label', { class: 'field' }, 'generation ', this.generation),
          h('label', { class: 'field' }, 'candidate ', this.among),
          button('first champion', () => this.goTo(this.champions[0])),
          button('last champion', async () => {
            this.champions = await ask(api('champions'));
            this.goTo(this.champions.at(-1));
          })),
        this.facts),
      card('Replay', this.replay),
      two(card('Network', this.network),
        h('div', { class: 'stack' }, card('Trials', this.trials), card('Genome', this.genome))));
  }

  goTo(champion) {
    if (champion) this.go(champion.generation, champion.candidate);
  }

  // Show a candidate of a generation; null: the best.
  async go(generation, candidate) {
    try {
      const all = await ask(api('generation', { generation }));
      const has = this.finished ? `, which has ${this.finished}` : '';
      if (!all.length) throw new Error(`generation ${generation + 1} is not in the record${has}`);
      this.generation.value = generation + 1;
      fill(this.among, ...all.map((one, place) => h('option', {
        value: String(one.candidate),
        text: `${one.candidate}: ${number(one.fitness)}${place === 0 ? ' (best)' : ''}` })));
      this.at = { generation, candidate: candidate ?? all[0].candidate };
      this.among.value = String(this.at.candidate);
      history.replaceState(null, '', address('/candidate', this.at));
      const of = await ask(api('candidate', this.at));
      const place = all.findIndex((one) => one.candidate === of.candidate) + 1;
      const genes = of.genes ? `, ${number(of.genes)} genes` : '';
      const name = `candidate ${of.candidate} of generation ${generation + 1}`;
      const unit = unitOf(of.fitness_trials), mean = all[place - 1].fitness;
      const rank = `fitness ${number(mean)}${unit && ` (${unit})`}, number ${place} of ${all.length}`;
      setText(this.facts, `${name}: ${rank}; ${of.genome.length / 2} bytes${genes}`);
      this.showNetwork(of);
      this.showGenome(of);
      this.showTrials(of);
      this.stop();
      fill(this.replay, button(`Play trial ${of.trials[0]?.trial ?? 0}`,
        () => this.play(of.trials[0]?.trial ?? 0), { class: 'main' }));
      if (query.has('trial')) await this.play(Number(query.get('trial')));
    } catch (error) {
      setText(this.facts, error.message);
    }
  }

  showNetwork({ edges, graph, why }) {
    if (!graph) {
      fill(this.network, note(`no drawing: ${why}`, 'dim'));
      return;
    }
    const shown = graph.edges.length;
    const cut = edges > shown ? `the strongest ${number(shown)} of ${number(edges)} connections; `
      : '';
    const hint = `${cut}orange: positive, blue and dashed: negative; point at a node or step to it with Tab`;
    const { sensors, actuators } = this.about;
    fill(this.network, drawNetwork(graph, sensors, actuators,
      (text) => setText(this.readout, text || hint)), this.readout);
    setText(this.readout, hint);
  }

  showGenome(of) {
    const { generation, candidate, genome, numbers } = of, known = numbers?.length > 0;
    const json = () => new Blob([JSON.stringify(of, null, 1)], { type: 'application/json' });
    const shown = known ? numbers.map((value) => value.toFixed(3)).join('  ') : genome.slice(0, HEX);
    fill(this.genome,
      row(copyButton('copy as hex', genome),
        known && copyButton('copy numbers', JSON.stringify(numbers)),
        button('JSON', () => save(json(), `${run}-${generation}-${candidate}.json`))),
      h('p', { class: 'genome mono', tabindex: 0, text: shown }));
  }

  showTrials({ left_out: left, trials }) {
    const metrics = [...new Set(trials.flatMap((trial) => Object.keys(trial.metrics)))];
    const games = trials.some((trial) => trial.candidates);
    const numbers = ['trial', 'fitness', ...metrics].map((name) => [name, 'n']);
    const rows = trials.map(({ candidates, fitness, game, metrics: values, server, trial }) => [
      ...(games ? [n(game), candidates.join(', ')] : []), n(trial),
      [fitness.map((value) => number(value)).join(', '), 'n'],
      ...metrics.map((name) => n(values[name])),
      [server, 'wrap'], button('replay', () => this.play(trial), { class: 'small' })]);
    fill(this.trials, rows.length
      ? table([...(games ? [['game', 'n'], 'players'] : []), ...numbers, 'server', ''], rows)
      : note('the record has no trials of it', 'dim'),
    left > 0 && note(`${number(left)} more are not listed`, 'dim'));
  }

  stop() {
    this.player?.destroy();
    this.player = null;
  }

  async play(trial) {
    this.stop();
    fill(this.replay, h('p', { class: 'dim', role: 'status',
      text: `computing trial ${trial} from the record …` }));
    try {
      const answer = await request(api('trace', { ...this.at, trial }));
      const { play } = await import('./player.js');
      const place = h('div');
      fill(this.replay, place);
      this.player = await play(place, await answer.arrayBuffer());
    } catch (error) {
      fill(this.replay, note(`no replay: ${error.message}`));
    }
  }
}
