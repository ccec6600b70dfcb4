// The stream from the server that a page shows, and the requests that it sends.
const SILENT_MS = 6000;
let heard = 0;

// actions: kind of a message -> what shows it. command: printed the address. lost: called with why
// nothing comes
export function listen(actions, command, lost) {
  const stream = new EventSource("stream");
  for (const [kind, action] of Object.entries(actions)) {
    stream.addEventListener(kind, (event) => {
      heard = Date.now();
      action(JSON.parse(event.data));
    });
  }
  stream.addEventListener("beat", () => { heard = Date.now(); });
  stream.onopen = () => { heard = Date.now(); };
  stream.onerror = () => {
    if (stream.readyState === EventSource.CLOSED) {
      lost(`The page is refused; open the address that ${command} printed.`);
    }
  };
  setInterval(() => {
    if (heard && Date.now() - heard > SILENT_MS) lost("No connection to the computer in the car.");
  }, 1000);
}

// the server's objection; empty if it took the request
export async function request(kind, content) {
  try {
    const answer = await fetch(kind, { method: "POST", body: JSON.stringify(content),
      headers: { "Content-Type": "application/json", "X-Calm-Edge": "page" } });
    return answer.ok ? "" : (await answer.text()).trim();
  } catch { return "Not passed on: no connection."; }
}
