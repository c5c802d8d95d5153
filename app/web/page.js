// The live page. One request, /live, brings colour, depth and status of the same frame; the depth
// shown and the value under the marker both come from its 16-bit millimetres.
import { LiveStream } from "/live.js";
import { DepthPainter, formatDistance } from "/depth.js";

const $ = (id) => document.getElementById(id);
const screens = [$("colour-screen"), $("depth-screen")];
const colourContext = $("colour").getContext("2d", { alpha: false });
const painter = new DepthPainter($("depth"), $("scale"));

let marker = { x: 0.5, y: 0.5 };  // fraction of the picture's width and height
let depth = null;                 // {width, height, sequence, scale, values} of the shown frame
let status = null;
let statusTime = 0;               // performance.now() when `status` came
let link = "connecting";          // connecting, up, or offline
let linkText = "";
let frozen = false;
let recordFault = "";            // why the last Record press did nothing

// ---- what is shown ------------------------------------------------------------------------------

function setText(id, text) {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
}

function placeMarkers(label) {
  for (const screen of screens) {
    const spot = screen.querySelector(".marker");
    spot.style.left = `${100 * marker.x}%`;
    spot.style.top = `${100 * marker.y}%`;
    spot.classList.toggle("is-right", marker.x > 0.75);
    spot.firstElementChild.textContent = label;
  }
}

// A value belongs to a picture that is shown: behind the veil there is none.
function showMarker() {
  if (!depth || screens[0].classList.contains("is-waiting")) return;
  const x = Math.min(depth.width - 1, Math.floor(marker.x * depth.width));
  const y = Math.min(depth.height - 1, Math.floor(marker.y * depth.height));
  const millimetres = depth.values[y * depth.width + x];
  const { text, unit } = formatDistance(millimetres, depth.scale);
  const output = $("distance");
  output.textContent = text;
  Object.assign(output.dataset, { x, y, millimetres, sequence: depth.sequence });
  setText("unit", unit);
  setText("place", `column ${x}, row ${y} of the depth picture`);
  placeMarkers(`${text} ${unit}`);
}

function showAge() {
  if (!status || status.frame.age_ms < 0) {
    setText("age", "\u2013");
    return;
  }
  const age = status.frame.age_ms + performance.now() - statusTime;
  setText("age", age < 2000 ? age.toFixed(0) : (age / 1000).toFixed(age < 10000 ? 1 : 0));
  setText("age-unit", age < 2000 ? "ms" : "s");
}

const stateNames = {
  starting: "Starting", booting: "Starting", streaming: "Live", recording: "Recording",
  degraded: "Degraded", fault: "Fault", "no signal": "No signal", finished: "Finished",
  "waiting for camera": "No signal: waiting for the camera", stopped: "Stopped",
  connecting: "Connecting", offline: "Reconnecting",
};
const liveStates = ["streaming", "recording", "degraded"];

// The device's state while depth comes; what the pictures say while it does not.
function currentState() {
  if (link !== "up") return link;
  const { state } = status.device;
  return state === "fault" || status.state === "streaming" ? state : status.state;
}

function showState() {
  const state = currentState();
  const pill = $("state");
  pill.dataset.state = state;
  setText("state", frozen && liveStates.includes(state) ? "Frozen" : stateNames[state] ?? state);
  const waiting = !liveStates.includes(state) && !frozen;
  $("device-note").hidden = link !== "up" || !["degraded", "fault"].includes(state);
  if (link === "up") setText("device-reason", status.device.reason);
  if (waiting) {
    setText("distance", "\u2013");
    setText("unit", "");
    setText("place", "");
  }
  for (const screen of screens) {
    screen.classList.toggle("is-waiting", waiting);
    if (!waiting) continue;
    const [title, text] = screen.querySelectorAll(".veil > *");
    title.textContent = stateNames[state] ?? state;
    text.textContent = link === "up" ? waitText() : linkText;
  }
}

function waitText() {
  if (status.state === "starting") return "The first depth picture is on its way.";
  const age = status.frame.age_ms + performance.now() - statusTime;
  const last = status.frame.age_ms < 0 ? "" : `Last frame ${(age / 1000).toFixed(0)} s ago. `;
  return last + (status.device.reason || status.fault);
}

function showFigures() {
  const { frames, inference_ms: inference } = status;
  setText("rate", status.frames_per_second.toFixed(1));
  setText("inference", inference.p50 < 0 ? "\u2013" : inference.p50.toFixed(0));
  setText("inference-tail", inference.p99 < 0 ? "median" : `median; 99 % under ${inference.p99.toFixed(0)}`);
  setText("dropped", String(frames.dropped));
  setText("source", `${status.source.description} \u00b7 ${status.source.uri}`);
  setText("colour-size", `${status.source.width} \u00d7 ${status.source.height}`);
  setText("depth-size", `${status.depth.width} \u00d7 ${status.depth.height}, 16 bit`);
  $("scale-note").hidden = status.depth.scale === "metric";
  const aspect = `${status.source.width} / ${status.source.height}`;
  for (const screen of screens) screen.style.setProperty("--aspect", aspect);
}

const megabytes = (bytes) => `${(bytes / 1e6).toFixed(1)} MB`;

function recoverySteps() {
  const { recovery } = status;
  return `${recovery.stream_restarts} stream restarts, ${recovery.reopenings} reopenings, ` +
    `${recovery.device_waits} waits for the device, ${recovery.port_resets} port resets`;
}

function showDetails() {
  const { frames, model } = status;
  const rows = [
    ["Model", model.name], ["Licence", model.licence],
    ["Network input", `${model.width} \u00d7 ${model.height}`],
    ["Engine threads", model.threads], ["Arena", megabytes(model.arena_bytes)],
    ["Weights", megabytes(model.weight_bytes)], ["Depth scale", status.depth.scale],
    ["Latency, sensor to depth", status.frame.latency_ms < 0 ? "\u2013" : `${status.frame.latency_ms.toFixed(0)} ms`],
    ["Frames captured", frames.captured], ["Frames with depth", frames.inferred],
    ["Lost by the source", frames.sequence_gaps], ["Broken", frames.corrupt],
    ["Refused by the engine", frames.failed], ["Camera time-outs", frames.timeouts],
    ["Recovery", recoverySteps()], ["Skipped while resting", frames.skipped],
    ["Effort", status.effort.rung],
    ["Temperature", status.thermal.celsius === null ? "\u2013" : `${status.thermal.celsius.toFixed(0)} \u00b0C`],
    ["Watchdog", status.watchdog.managed ? `${status.watchdog.pings} pings` : "none"],
    ["Threads that hung", status.device.missed_vital + status.device.missed_outputs],
    ["Viewers", status.viewers],
    ["Up for", `${Math.floor(status.uptime_s / 60)} min`], ["Version", status.version],
  ];
  $("details").replaceChildren(...rows.map(([name, value]) => {
    const row = document.createElement("div");
    const term = row.appendChild(document.createElement("dt"));
    const text = row.appendChild(document.createElement("dd"));
    term.textContent = name;
    text.textContent = String(value);
    return row;
  }));
}

// ---- what comes in ------------------------------------------------------------------------------

async function onMessage(message) {
  status = message.status;
  statusTime = performance.now();
  link = "up";
  if (message.depth && !frozen) {
    const picture = await createImageBitmap(new Blob([message.jpeg], { type: "image/jpeg" }));
    if (frozen) return;
    const { canvas } = colourContext;
    if (canvas.width !== picture.width || canvas.height !== picture.height) {
      canvas.width = picture.width;
      canvas.height = picture.height;
    }
    colourContext.drawImage(picture, 0, 0);
    picture.close();
    depth = message.depth;
    const range = painter.paint(depth);
    for (const [id, metres] of [["near", range.nearest], ["far", range.farthest]]) {
      const { text, unit } = formatDistance(Math.round(1000 * metres), depth.scale);
      setText(id, `${text} ${unit}`);
    }
  }
  showFigures();
  showRecording();
  showState();
  if (message.depth) showMarker();
  if (document.querySelector(".details").open) showDetails();
}

function onLost(text) {
  link = "offline";
  linkText = text;
  showState();
}

// ---- what the person does -----------------------------------------------------------------------

function point(event) {
  const box = event.currentTarget.getBoundingClientRect();
  const clamp = (value) => Math.min(0.999999, Math.max(0, value));
  marker = {
    x: clamp((event.clientX - box.left) / box.width),
    y: clamp((event.clientY - box.top) / box.height),
  };
  showMarker();
}

const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

function nudge(event) {
  const step = arrows[event.key];
  if (!step || !depth) return;
  event.preventDefault();
  const pixels = event.shiftKey ? 10 : 1;
  const move = (value, direction, size) =>
    Math.min(size - 0.5, Math.max(0.5, Math.floor(value * size) + 0.5 + direction * pixels)) / size;
  marker = { x: move(marker.x, step[0], depth.width), y: move(marker.y, step[1], depth.height) };
  showMarker();
}

for (const screen of screens) {
  screen.tabIndex = 0;
  screen.addEventListener("pointermove", point);
  screen.addEventListener("pointerdown", point);
  screen.addEventListener("keydown", nudge);
}

function toggleFreeze() {
  frozen = !frozen;
  $("freeze").setAttribute("aria-pressed", String(frozen));
  if (status) showState();
}

// Resolves to the token that was typed, or to null.
function askToken() {
  const dialog = $("token-dialog");
  const input = $("token");
  input.value = "";
  dialog.showModal();
  return new Promise((resolve) => {
    const end = (value) => {
      dialog.oncancel = null;
      dialog.close();
      resolve(value);
    };
    dialog.oncancel = () => end(null);
    $("token-cancel").onclick = () => end(null);
    $("token-send").onclick = () => {
      if (/^[!-~]+$/.test(input.value.trim())) end(input.value.trim());
    };
    input.onkeydown = (event) => event.key === "Enter" && $("token-send").click();
  });
}

// A request that changes something. From the network it needs the token, which is kept until this
// tab is closed.
async function control(path) {
  for (;;) {
    const token = sessionStorage.getItem("token");
    const headers = token ? { Authorization: `Bearer ${token}` } : {};
    const answer = await fetch(path, { method: "POST", headers });
    if (answer.status !== 401) return answer;
    const typed = await askToken();
    if (typed === null) return answer;
    sessionStorage.setItem("token", typed);
  }
}

// Colour frames into MCAP segments on the device. What the button shows is what the status says.
async function toggleRecording() {
  if (!status) return;
  const action = status.recording.on ? "stop" : "start";
  try {
    const answer = await control(`/record/${action}`);
    recordFault = answer.ok ? "" : (await answer.text()).trim();
  } catch {
    recordFault = "the camera does not answer";
  }
  showRecording();
}

function showRecording() {
  const { on, frames, dropped, fault, file } = status.recording;
  if (on) recordFault = "";  // by another page or the button
  $("record").setAttribute("aria-pressed", String(on));
  setText("record", on ? "Recording" : "Record");
  const problem = recordFault || fault;
  $("record-note").hidden = !on && !problem;
  const lost = dropped ? `, ${dropped} lost` : "";
  setText("record-text", on ? `${file}: ${frames} frames${lost}` : problem);
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  localStorage.setItem("theme", theme);
}

const systemTheme = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
setTheme(localStorage.getItem("theme") ?? systemTheme);
const toggleTheme = () =>
  setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light");

$("record").addEventListener("click", toggleRecording);
$("freeze").addEventListener("click", toggleFreeze);
$("theme").addEventListener("click", toggleTheme);
document.querySelector(".details").addEventListener("toggle", () => status && showDetails());
document.addEventListener("keydown", (event) => {
  const onControl = event.target.closest("button, a, summary");
  if (event.ctrlKey || event.metaKey || event.altKey || $("token-dialog").open) return;
  if (event.key === " " && !onControl) {
    event.preventDefault();
    toggleFreeze();
  } else if (event.key === "r") {
    toggleRecording();
  } else if (event.key === "t") {
    toggleTheme();
  }
});

setInterval(() => {
  showAge();
  if (status && link === "up" && !liveStates.includes(currentState())) showState();
}, 100);
new LiveStream("/live", onMessage, onLost).run();
