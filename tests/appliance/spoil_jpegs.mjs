// Takes the JPEGs out of a multipart stream and writes them as a camera's frames, whole and spoiled:
//
//   node spoil_jpegs.mjs STREAM FOLDER SEED
//
//   FOLDER/whole     as they came
//   FOLDER/cut       their end is missing: at least two bytes, at most all but two
//   FOLDER/flipped   some bits are wrong, anywhere behind the first marker
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";

const kVariants = 5; // of each picture and way to spoil it
const kMostFlips = 24;

const [stream, folder, seed] = process.argv.slice(2);
const pictures = jpegsOf(readFileSync(stream));
if (pictures.length === 0) throw new Error(`${stream}: no whole JPEG in it`);
const below = generator(Number(seed));

write("whole", pictures);
write("cut", variants(cut));
write("flipped", variants(flipped));

// Every part has its length in its head; the last one may be incomplete.
function jpegsOf(bytes) {
  const found = [];
  const text = bytes.toString("latin1");
  for (const head of text.matchAll(/Content-Length: (\d+)\r\n(?:[^\r]+\r\n)*\r\n/g)) {
    const begin = head.index + head[0].length;
    const end = begin + Number(head[1]);
    if (end <= bytes.length) found.push(bytes.subarray(begin, end));
  }
  return found;
}

function variants(spoil) {
  return pictures.flatMap((picture) => Array.from({ length: kVariants }, () => spoil(picture)));
}

function cut(picture) {
  return picture.subarray(0, 2 + below(picture.length - 3));
}

function flipped(picture) {
  const copy = Buffer.from(picture);
  for (let flips = 1 + below(kMostFlips); flips > 0; --flips) {
    copy[2 + below(copy.length - 2)] ^= 1 << below(8);
  }
  return copy;
}

// below(n): a number from 0 to n - 1. A linear congruence of full period, its upper half.
function generator(state) {
  return (n) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * n);
  };
}

function write(name, frames) {
  mkdirSync(join(folder, name), { recursive: true });
  frames.forEach((frame, i) => writeFileSync(join(folder, name, `${i}.jpg`), frame));
}
