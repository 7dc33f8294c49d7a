// A worker that gives signs of life while the browser asks whether to leave, which holds up the page: for some seconds.
import { events } from "./server.js";

const LONGEST = 10_000; // milliseconds; then the rig's watchdog stops it
const PERIOD = 150;
let socket = null;
let timer = 0;

self.onmessage = ({ data: asking }) => {
  clearInterval(timer);
  socket?.close();
  if (!asking) return;
  const end = Date.now() + LONGEST;
  socket = events(location);
  timer = setInterval(() => {
    if (Date.now() > end) clearInterval(timer);
    else if (socket.readyState === WebSocket.OPEN) socket.send('{"kind":"alive"}');
  }, PERIOD);
};
