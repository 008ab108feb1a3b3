// The WebSocket of a page: it comes back by itself, and says how old what is shown has become.
import { duration, setText, token } from './page.js';

const SILENT_MS = 7000; // the dashboard says something every two seconds
const RETRY_MS = [300, 700, 1500, 3000, 5000];

export function follow(run, onmessage) {
  const banner = document.getElementById('banner');
  const link = document.getElementById('link');
  let since = '';
  let heard = performance.now();
  let tries = 0;
  let socket = null;
  let refused = '';

  function connect() {
    const values = new URLSearchParams({ ...(run ? { run } : {}), ...(since ? { since } : {}) });
    const protocols = ['zswarm', ...(token() ? [`token.${token()}`] : [])];
    socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/ws?${values}`, protocols);
    const mine = socket;
    socket.onmessage = (event) => {
      if (mine !== socket) return;
      const message = JSON.parse(event.data);
      heard = performance.now();
      tries = 0;
      since = message.seq;
      window.__zswarm.messages += 1;
      window.__zswarm.seq = since;
      onmessage(message);
      show();
    };
    socket.onclose = (event) => {
      if (mine !== socket) return;
      socket = null;
      refused = event.code === 4404 ? 'this run is not there any more' : '';
      setTimeout(connect, RETRY_MS[Math.min(tries, RETRY_MS.length - 1)]);
      tries += 1;
      show();
    };
  }

  function show() {
    const open = socket?.readyState === WebSocket.OPEN && tries === 0;
    const lost = !open && (tries > 0 || performance.now() - heard > 2000);
    banner.hidden = !lost;
    if (lost) setText(banner, refused || `connection lost, retrying; what is shown is ${duration((performance.now() - heard) / 1000)} old`);
    setText(link, open ? 'live' : '…');
    link.classList.toggle('on', open);
  }

  setInterval(() => {
    if (socket?.readyState === WebSocket.OPEN && performance.now() - heard > SILENT_MS) {
      const silent = socket; // such as after a sleep of this machine: nobody will ever say that it ended
      silent.onclose(new CloseEvent('close', { code: 4000 }));
      silent.close();
    }
    show();
  }, 500);
  connect();
}
