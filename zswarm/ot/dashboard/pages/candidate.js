// One candidate: its genome, its network, what it did in each trial, and the replay of one.
import { drawNetwork } from './network.js';
import { address, api, ask, card, copyButton, download, fill, h, number, query, run, save, setText, showError } from './page.js';
import { follow } from './live.js';

export async function show(view) {
  const about = await ask(api('about'));
  document.title = `Candidate of ${about.name} · zswarm`;
  let champions = await ask(api('champions'));
  let finished = 0;
  let generation = query.has('generation') ? Number(query.get('generation')) : champions.at(-1)?.generation ?? 0;
  let candidate = query.has('candidate') ? Number(query.get('candidate')) : null;
  let player = null;
  const title = h('h1', { text: about.name });
  const chosen = h('input', { type: 'number', min: 1, step: 1, 'aria-label': 'generation', onchange: () => go(Math.max(0, Number(chosen.value) - 1), null) });
  const among = h('select', { 'aria-label': 'candidate', onchange: () => go(generation, Number(among.value)) });
  const facts = h('p', { class: 'dim' });
  const network = card('Network');
  const genome = card('Genome');
  const trials = card('Trials');
  const replay = card('Replay');
  fill(view,
    h('section', { class: 'card' }, h('div', { class: 'row' }, title),
      h('div', { class: 'row' }, h('label', { class: 'field' }, 'generation ', chosen), h('label', { class: 'field' }, 'candidate ', among),
        h('button', { type: 'button', text: 'first champion', onclick: () => champions.length && go(champions[0].generation, champions[0].candidate) }),
        h('button', { type: 'button', text: 'last champion', onclick: async () => { champions = await ask(api('champions')); if (champions.length) go(champions.at(-1).generation, champions.at(-1).candidate); } })),
      facts),
    replay, h('div', { class: 'two' }, network, h('div', { class: 'stack' }, trials, genome)));

  async function go(toGeneration, toCandidate) {
    try {
      const all = await ask(api('generation', { generation: toGeneration }));
      if (!all.length) throw new Error(`generation ${toGeneration + 1} is not in the record${finished ? `, which has ${finished}` : ''}`);
      generation = toGeneration;
      candidate = toCandidate ?? all[0].candidate;
      chosen.value = generation + 1;
      fill(among, ...all.map((one, place) => h('option', { value: String(one.candidate), text: `${one.candidate}: ${number(one.fitness)}${place === 0 ? ' (best)' : ''}` })));
      among.value = String(candidate);
      history.replaceState(null, '', address('/candidate', { generation, candidate }));
      await showCandidate(await ask(api('candidate', { generation, candidate })), all);
    } catch (error) {
      setText(facts, error.message);
    }
  }

  async function showCandidate(of, all) {
    const place = all.findIndex((one) => one.candidate === candidate) + 1;
    setText(facts, `candidate ${candidate} of generation ${generation + 1}: fitness ${number(of.fitness)}, number ${place} of ${all.length}; ${of.genome.length / 2} bytes${of.genes ? `, ${number(of.genes)} genes` : ''}`);
    const said = h('p', { class: 'readout', 'aria-live': 'polite', text: '' });
    fill(network, h('h2', { text: 'Network' }), of.graph ? drawNetwork(of.graph, about.sensors, about.actuators, (text) => setText(said, text || hint(of))) : h('p', { class: 'dim', text: `no drawing: ${of.why}` }), said);
    if (of.graph) setText(said, hint(of));
    fill(genome, h('h2', { text: 'Genome' }), h('div', { class: 'row' }, copyButton('copy as hex', of.genome),
      of.numbers?.length ? copyButton('copy numbers', JSON.stringify(of.numbers)) : null,
      h('button', { type: 'button', text: 'JSON', onclick: () => save(new Blob([JSON.stringify(of, null, 1)], { type: 'application/json' }), `${run}-${generation}-${candidate}.json`) })),
    h('p', { class: 'genome mono', tabindex: 0, text: of.numbers?.length ? of.numbers.map((value) => value.toFixed(3)).join('  ') : of.genome.slice(0, 8000) }));
    const names = [...new Set(of.trials.flatMap((trial) => Object.keys(trial.metrics)))];
    const game = of.trials.some((trial) => trial.candidates);
    fill(trials, h('h2', { text: 'Trials' }), of.trials.length ? h('div', { class: 'scroll' }, h('table', {},
      h('thead', {}, h('tr', {}, ...[...(game ? ['game', 'players'] : []), 'trial', 'fitness', ...names, 'server', ''].map((text) => h('th', { scope: 'col', text })))),
      h('tbody', {}, ...of.trials.map((trial) => h('tr', {}, ...(game ? [h('td', { class: 'n', text: number(trial.game) }), h('td', { text: trial.candidates.join(', ') })] : []),
        h('td', { class: 'n', text: String(trial.trial) }), h('td', { class: 'n', text: trial.fitness.map((value) => number(value)).join(', ') }),
        ...names.map((name) => h('td', { class: 'n', text: number(trial.metrics[name]) })), h('td', { class: 'wrap', text: trial.server }),
        h('td', {}, h('button', { type: 'button', class: 'small', text: 'replay', onclick: () => play(trial.trial) }))))))) : h('p', { class: 'dim', text: 'the record has no trials of it' }),
    of.left_out ? h('p', { class: 'dim', text: `${number(of.left_out)} more are not listed` }) : null);
    player?.destroy();
    player = null;
    fill(replay, h('h2', { text: 'Replay' }), h('button', { type: 'button', class: 'main', text: 'Play trial 0', onclick: () => play(of.trials[0]?.trial ?? 0) }));
    if (query.has('trial')) await play(Number(query.get('trial')));
  }

  function hint(of) {
    const cut = of.edges > of.graph.edges.length ? `the strongest ${number(of.graph.edges.length)} of ${number(of.edges)} connections; ` : '';
    return `${cut}blue: positive, orange and dashed: negative; point at a node or step to it with Tab`;
  }

  async function play(trial) {
    player?.destroy();
    player = null;
    const place = h('div', { class: 'player' });
    fill(replay, h('h2', { text: `Replay of trial ${trial}` }), h('p', { class: 'dim', role: 'status', text: 'computing it from the record …' }));
    try {
      const bytes = await ask(api('trace', { generation, candidate, trial }), 'bytes');
      await style('/static/player.css');
      const { play: start } = await import('/static/player.js');
      fill(replay, h('h2', { text: `Replay of trial ${trial}` }), place);
      player = await start(place, bytes);
    } catch (error) {
      fill(replay, h('h2', { text: 'Replay' }), h('p', { class: 'note', text: `no replay: ${error.message}` }));
    }
  }

  follow(run, (message) => { if (message.state) finished = message.state.generation ?? finished; });
  try {
    await go(generation, candidate);
  } catch (error) {
    showError(error.message);
  }
}

// Its colours are read when the player begins.
async function style(href) {
  if (document.querySelector(`link[href="${href}"]`)) return;
  const link = h('link', { rel: 'stylesheet', href });
  await new Promise((done) => { link.onload = done; link.onerror = done; document.head.append(link); });
}
