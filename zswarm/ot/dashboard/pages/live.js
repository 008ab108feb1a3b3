// The WebSocket of a page: it reconnects, and shows how old the page has become.
import { duration, setText, token } from './page.js';

const SILENT_MS = 7000; // the dashboard sends a message every two seconds
const LOST_MS = 2000; // from which on a connection that is not open counts as lost
const RETRY_MS = [300, 700, 1500, 3000, 5000];
const NO_SUCH_RUN = 4404;

export function follow(run, onmessage) {
  const banner = document.getElementById('banner'), link = document.getElementById('link');
  let since = '', heard = performance.now(), tries = 0, socket = null, refused = '';

  function connect() {
    const values = new URLSearchParams({ ...(run && { run }), ...(since && { since }) });
    const protocols = ['zswarm', ...(token() ? [`token.${token()}`] : [])];
    const mine = new WebSocket(`${location.origin.replace('http', 'ws')}/ws?${values}`, protocols);
    socket = mine;
    mine.onmessage = (event) => {
      if (mine !== socket) return;
      const message = JSON.parse(event.data);
      [heard, tries, since] = [performance.now(), 0, message.seq];
      onmessage(message);
      show();
    };
    mine.onclose = (event) => { if (mine === socket) retry(event.code); };
  }

  function retry(code) {
    socket = null;
    refused = code === NO_SUCH_RUN ? 'this run no longer exists' : '';
    setTimeout(connect, RETRY_MS[Math.min(tries, RETRY_MS.length - 1)]);
    tries += 1;
    show();
  }

  function show() {
    const open = socket?.readyState === WebSocket.OPEN && tries === 0;
    const silent = performance.now() - heard;
    banner.hidden = open || (tries === 0 && silent <= LOST_MS);
    const age = duration(silent / 1000);
    const lost = refused || `connection lost, retrying; what is shown is ${age} old`;
    if (!banner.hidden) setText(banner, lost);
    setText(link, open ? 'live' : '…');
    link.classList.toggle('on', open);
  }

  setInterval(() => {
    const open = socket?.readyState === WebSocket.OPEN;
    if (open && performance.now() - heard > SILENT_MS) { // as after a sleep of this machine
      const silent = socket;
      retry();
      silent.close();
    }
    show();
  }, 500);
  connect();
}
