// The live page in Chromium, against the real program.
//
//   node page.mjs LCDM MODEL FOLDER [SCREENSHOT]
//
// LCDM is the program, MODEL a weights file, FOLDER an empty folder to work in. Prints one line for
// each thing that holds, and ends with status 1 at the first that does not.
import { spawn } from "node:child_process";
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { networkInterfaces } from "node:os";
import { join } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";
import { chromium } from "playwright-core";
import { PNG } from "pngjs";

const [program, model, folder, screenshot] = process.argv.slice(2);

// Every `lcdm run` that was started; none outlives this script, however it ends.
const cameras = new Set();
process.on("exit", () => cameras.forEach((camera) => camera.kill("SIGKILL")));

function check(holds, what) {
  if (!holds) throw new Error(`does not hold: ${what}`);
  console.log(`ok: ${what}`);
}

async function eventually(condition, what, seconds = 15) {
  const end = Date.now() + 1000 * seconds;
  while (!(await condition())) {
    if (Date.now() > end) throw new Error(`did not come: ${what}`);
    await sleep(30);
  }
  console.log(`ok: ${what}`);
}

// A folder of three pictures for `file:`.
function makePictures() {
  const pictures = join(folder, "pictures");
  mkdirSync(pictures, { recursive: true });
  for (let i = 0; i < 3; i++) {
    const png = new PNG({ width: 160, height: 120 });
    for (let at = 0; at < png.data.length; at++) png.data[at] = (at * (i + 3)) % 251 | 64;
    writeFileSync(join(pictures, `${i}.png`), PNG.sync.write(png));
  }
  return pictures;
}

// Starts `lcdm run` and resolves to {process, address} when it has printed where it is.
function startCamera(port, source = "scene:", ...more) {
  const args = ["run", "--source", source, "--model", model, "--port", String(port),
    "--set", "model.width=128", "--set", "model.height=96", ...more];
  const camera = spawn(program, args, { stdio: ["ignore", "pipe", "inherit"] });
  cameras.add(camera);
  return new Promise((resolve, reject) => {
    let output = "";
    camera.stdout.on("data", (text) => {
      output += text;
      const address = /page +(http:\S+)/.exec(output);
      if (address) resolve({ process: camera, address: address[1] });
    });
    camera.on("exit", (code) => reject(new Error(`lcdm ended with ${code}:\n${output}`)));
  });
}

// Resolves to the exit status.
function stopCamera(camera) {
  return new Promise((resolve) => {
    camera.process.removeAllListeners("exit");
    camera.process.on("exit", (code) => resolve(code));
    camera.process.kill("SIGTERM");
  });
}

// What the page says about the marker, for every frame it shows from now on.
async function watchMarker(page) {
  await page.evaluate(() => {
    const output = document.getElementById("distance");
    window.shown = {};
    new MutationObserver(() => {
      window.shown[output.dataset.sequence] = { ...output.dataset, text: output.textContent };
    }).observe(output, { attributes: true });
  });
}

// The same numbers by another way and another decoder: the 16-bit PNG, read by pngjs.
async function fetchDepth(address) {
  const answer = await fetch(new URL("/depth.png", address));
  const png = PNG.sync.read(Buffer.from(await answer.arrayBuffer()), { skipRescale: true });
  return {
    sequence: answer.headers.get("x-frame-sequence"),
    scale: answer.headers.get("x-depth-scale"),
    width: png.width,
    height: png.height,
    at: (x, y) => png.data[4 * (y * png.width + x)],
    depth: png.depth,
  };
}

async function picturesChange(page) {
  const samples = { colour: new Set(), depth: new Set() };
  await eventually(async () => {
    for (const id of Object.keys(samples)) {
      samples[id].add(await page.evaluate((name) => {
        const canvas = document.getElementById(name);
        const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        let hash = 0;
        for (const byte of data) hash = (31 * hash + byte) | 0;
        return hash;
      }, id));
    }
    return samples.colour.size >= 5 && samples.depth.size >= 5;
  }, "five different pictures of colour and of depth");
}

// Moves the pointer to a place in one picture; the markers of both stand there.
async function point(page, screen, x, y) {
  const box = await page.locator(screen).boundingBox();
  await page.mouse.move(box.x + x * box.width, box.y + y * box.height);
  for (const id of ["#colour-screen", "#depth-screen"]) {
    const outer = await page.locator(id).boundingBox();
    const inner = await page.locator(`${id} .marker`).boundingBox();
    const dx = (inner.x + inner.width / 2 - outer.x) / outer.width - x;
    const dy = (inner.y + inner.height / 2 - outer.y) / outer.height - y;
    check(Math.abs(dx) < 0.01 && Math.abs(dy) < 0.01, `the marker of ${id} stands where ${screen} is pointed at`);
  }
}

async function valueIsTheDepthImages(page, address, x, y) {
  let compared = 0;
  for (let attempt = 0; compared < 3 && attempt < 60; attempt++) {
    const image = await fetchDepth(address);
    check(image.depth === 16, "depth.png has 16 bits");
    await sleep(300);
    const shown = (await page.evaluate(() => window.shown))[image.sequence];
    if (!shown) continue;
    const column = Math.floor(x * image.width);
    const row = Math.floor(y * image.height);
    const millimetres = image.at(column, row);
    check(Number(shown.x) === column && Number(shown.y) === row, `pixel ${column}, ${row}`);
    check(Number(shown.millimetres) === millimetres,
      `frame ${image.sequence}: the page says ${shown.millimetres}, the image ${millimetres} mm`);
    const digits = millimetres < 10000 ? 2 : 1;
    check(shown.text === (millimetres / 1000).toFixed(digits), `in words ${shown.text}`);
    compared++;
  }
  check(compared === 3, "three frames were compared");
}

async function keysMoveAndFreeze(page) {
  const data = () => page.evaluate(() => ({ ...document.getElementById("distance").dataset }));
  await page.locator("#depth-screen").focus();
  const before = await data();
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("ArrowDown");
  await page.keyboard.press("Shift+ArrowLeft");
  const after = await data();
  check(Number(after.x) === Number(before.x) - 9 && Number(after.y) === Number(before.y) + 1,
    "arrow keys move the marker by pixels");
  await page.keyboard.press(" ");
  await sleep(300);
  const frozen = await data();
  await sleep(1200);
  check((await data()).sequence === frozen.sequence, "space freezes the picture");
  check(await page.textContent("#state") === "Frozen", "and the state says so");
  await page.keyboard.press(" ");
  await eventually(async () => (await data()).sequence !== frozen.sequence, "space lets it go on");
}

async function showsTheScene(context) {
  const camera = await startCamera(0);
  const page = context.pages()[0] ?? (await context.newPage());
  const complaints = [];
  const strangers = [];
  page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(error.message));
  page.on("request", (request) => {
    if (!request.url().startsWith(camera.address)) strangers.push(request.url());
  });
  await page.goto(camera.address);
  const state = () => page.textContent("#state");
  await eventually(async () => (await state()) === "Live", "the state says Live");
  await picturesChange(page);

  await watchMarker(page);
  await point(page, "#colour-screen", 0.31, 0.62);
  await valueIsTheDepthImages(page, camera.address, 0.31, 0.62);
  await point(page, "#depth-screen", 0.77, 0.4);
  await valueIsTheDepthImages(page, camera.address, 0.77, 0.4);
  check((await page.textContent("#unit")) === "rel.", "depth without calibration is called rel.");
  check(await page.isVisible("#scale-note"), "and the page explains it");
  check((await fetchDepth(camera.address)).scale === "relative", "so does the image");
  await keysMoveAndFreeze(page);

  const figures = ["rate", "age", "inference", "dropped"];
  for (const id of figures) {
    check(/^[\d.]+$/.test(await page.textContent(`#${id}`)), `${id} is a number`);
  }
  check((await page.textContent("#source")).includes("scene:"), "the source is named");
  await page.click("summary");
  await eventually(async () => (await page.textContent("#details")).includes("Licence"), "the details open");
  check((await page.textContent("#details")).includes("0 stream restarts"), "the ladder's steps are shown");
  await page.click("#theme");
  check(await page.evaluate(() => document.documentElement.dataset.theme) === "light", "light theme");
  await page.click("#theme");
  check(strangers.length === 0, "nothing is asked of anybody else");
  check(complaints.length === 0, `no complaints in the console: ${complaints}`);
  if (screenshot) await page.screenshot({ path: screenshot });

  check((await stopCamera(camera)) === 0, "SIGTERM ends it cleanly");
  await eventually(async () => (await state()) === "Reconnecting", "the page notices");
  check(await page.isVisible("#depth-screen .veil"), "and no old picture passes for a live one");
  const again = await startCamera(new URL(camera.address).port);
  await eventually(async () => (await state()) === "Live", "the page comes back by itself", 30);
  await stopCamera(again);
}

// The pictures behind the source vanish and come back.
async function saysNoSignal(context) {
  const pictures = makePictures();
  const camera = await startCamera(0, `file:${pictures}`);
  const page = context.pages()[0];
  await page.goto(camera.address);
  const state = () => page.textContent("#state");
  const healthz = async () => (await fetch(new URL("/healthz", camera.address))).status;
  await eventually(async () => (await state()) === "Live", "a folder of pictures is a camera too");
  check((await healthz()) === 200, "healthz says well");
  rmSync(pictures, { recursive: true });
  await eventually(async () => (await state()) === "No signal", "without frames: No signal");
  const veil = page.locator("#depth-screen .veil");
  check(await veil.isVisible(), "and no old picture passes for a live one");
  check((await page.textContent("#distance")) === "\u2013", "nor an old value for a live one");
  check(/Last frame \d+ s ago/.test(await veil.textContent()), "the age of the last frame is told");
  check((await healthz()) === 503, "healthz says unwell");
  check((await fetch(new URL("/depth.png", camera.address))).status === 503, "and depth.png is refused");
  if (screenshot) await page.screenshot({ path: screenshot.replace(".png", "-no-signal.png") });
  makePictures();
  await eventually(async () => (await state()) === "Live", "the page is live again");
  await stopCamera(camera);
}

// From beyond loopback: looking is free, recording takes the token, which the page asks for once.
async function asksForTheToken(context) {
  const outside = Object.values(networkInterfaces()).flat()
    .find(({ family, internal }) => family === "IPv4" && !internal);
  if (!outside) return console.log("skipped: no address but loopback");
  const token = "0123456789abcdef";
  const file = join(folder, "token");
  writeFileSync(file, `${token}\n`, { mode: 0o600 });
  const camera = await startCamera(0, "scene:", "--listen", outside.address,
    "--set", `http.token_file=${file}`, "--set", `record.directory=${join(folder, "recordings")}`);
  const page = context.pages()[0];
  await page.goto(camera.address);
  await eventually(async () => (await page.textContent("#state")) === "Live", "looking needs no token");
  const dialog = page.locator("#token-dialog");
  await page.click("#record");
  await eventually(() => dialog.isVisible(), "recording does: the page asks for it");
  await page.click("#token-cancel");
  await eventually(async () => (await page.textContent("#record-text")).includes("token"), "without it nothing happens");
  await page.click("#record");
  await page.fill("#token", "wrong-wrong-wrong");
  await page.click("#token-send");
  await eventually(async () => (await dialog.isVisible()) && (await page.inputValue("#token")) === "", "a wrong one is asked for again");
  await page.fill("#token", token);
  await page.keyboard.press("Enter");
  await eventually(async () => (await page.textContent("#state")) === "Recording", "the right one records");
  await page.click("#record");
  await eventually(async () => (await page.textContent("#state")) === "Live", "and stops, without being typed again");
  await stopCamera(camera);
}

const context = await chromium.launchPersistentContext(mkdtempSync(join(folder, "profile-")), {
  executablePath: "/usr/bin/chromium",
  viewport: { width: 1440, height: 900 },
  colorScheme: "dark",
  args: ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync"],
});
let status = 0;
try {
  await showsTheScene(context);
  await saysNoSignal(context);
  await asksForTheToken(context);
} catch (error) {
  console.error(error.message);
  status = 1;
}
await context.close();
process.exit(status);
