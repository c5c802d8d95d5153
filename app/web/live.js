// The /live stream: an endless answer of messages, each
//   "LCDM", u32 JSON bytes, u32 JPEG bytes, u32 depth bytes, then the three parts;
// depth is little-endian uint16 millimetres, row by row. A message without pictures is a sign of
// life: the server sends one a second when there are no frames.

const headBytes = 16;
const maxMessageBytes = 64 << 20;
const silenceLimit = 5000;  // ms without a byte until the connection counts as dead
const retryDelays = [300, 600, 1200, 2400];

// Bytes in, whole messages out. Of several frames that wait, only the newest is given: a slow page
// skips, it never falls behind.
export class MessageReader {
  #chunks = [];
  #bytes = 0;

  push(chunk) {
    this.#chunks.push(chunk);
    this.#bytes += chunk.length;
  }

  newest() {
    let found = null;
    for (let message = this.#next(); message; message = this.#next()) {
      if (!found || message.depth || !found.depth) found = message;
    }
    return found;
  }

  #next() {
    if (this.#bytes < headBytes) return null;
    const head = this.#view(headBytes);
    if (head.getUint32(0) !== 0x4c43444d) throw new Error("not the live stream");
    const [json, jpeg, depth] = [4, 8, 12].map((offset) => head.getUint32(offset, true));
    const whole = headBytes + json + jpeg + depth;
    if (whole > maxMessageBytes) throw new Error("a message of absurd size");
    if (this.#bytes < whole) return null;
    const body = this.#take(whole);
    const status = JSON.parse(new TextDecoder().decode(body.subarray(headBytes, headBytes + json)));
    const message = { status, jpeg: null, depth: null };
    if (depth > 0) {
      const begin = headBytes + json;
      message.jpeg = body.subarray(begin, begin + jpeg);
      // Copied: the values must lie on an even address.
      const values = new Uint16Array(body.slice(begin + jpeg, whole).buffer);
      message.depth = { ...status.picture, scale: status.depth.scale, values };
    }
    return message;
  }

  #view(bytes) {
    if (this.#chunks[0].length < bytes) this.#join();
    return new DataView(this.#chunks[0].buffer, this.#chunks[0].byteOffset, bytes);
  }

  #take(bytes) {
    if (this.#chunks[0].length < bytes) this.#join();
    const body = this.#chunks[0].subarray(0, bytes);
    this.#chunks[0] = this.#chunks[0].subarray(bytes);
    this.#bytes -= bytes;
    return body;
  }

  #join() {
    const whole = new Uint8Array(this.#bytes);
    let at = 0;
    for (const chunk of this.#chunks) {
      whole.set(chunk, at);
      at += chunk.length;
    }
    this.#chunks = [whole];
  }
}

// What a person reads when the stream ended: browsers' own words for it help nobody.
function lostText(error) {
  if (error.name === "AbortError") return "Nothing came for 5 s. Trying again.";
  if (error instanceof TypeError) return "The camera does not answer. Trying again.";
  return error.message;
}

// Keeps the stream alive: onMessage(message) for frames and signs of life, onLost(text) when the
// connection is gone; tries again by itself, for ever.
export class LiveStream {
  constructor(url, onMessage, onLost) {
    Object.assign(this, { url, onMessage, onLost, failures: 0 });
  }

  async run() {
    for (;;) {
      try {
        await this.#connect();
      } catch (error) {
        this.onLost(lostText(error));
      }
      const delay = retryDelays[Math.min(this.failures++, retryDelays.length - 1)];
      await new Promise((resolve) => setTimeout(resolve, delay));
    }
  }

  async #connect() {
    const abort = new AbortController();
    let watchdog = setTimeout(() => abort.abort(), silenceLimit);
    try {
      const answer = await fetch(this.url, { signal: abort.signal, cache: "no-store" });
      if (!answer.ok) throw new Error((await answer.text()).trim());
      const bytes = answer.body.getReader();
      const reader = new MessageReader();
      for (;;) {
        const { done, value } = await bytes.read();
        if (done) throw new Error("The camera closed the connection. Trying again.");
        clearTimeout(watchdog);
        watchdog = setTimeout(() => abort.abort(), silenceLimit);
        reader.push(value);
        const message = reader.newest();
        if (!message) continue;
        this.failures = 0;
        await this.onMessage(message);
      }
    } finally {
      clearTimeout(watchdog);
      abort.abort();
    }
  }
}
