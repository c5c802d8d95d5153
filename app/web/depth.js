// Depth as colours and as words. Same colour map and same quantiles as app/depth_colour.cpp.

const coefficients = [
  [0.13572138, 4.6153926, -42.66032258, 132.13108234, -152.94239396, 59.28637943],
  [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604],
  [0.1066733, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973],
];

// Turbo at x in [0, 1] as a little-endian RGBA word.
function turbo(x) {
  const [r, g, b] = coefficients.map((c) => {
    const value = c.reduceRight((sum, factor) => sum * x + factor, 0);
    return Math.round(255 * Math.min(1, Math.max(0, value)));
  });
  return ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0;
}

const steps = 1024;
const ramp = Uint32Array.from({ length: steps }, (_, i) => turbo(1 - i / (steps - 1)));
const black = 0xff000000;

// {text, unit} for a value in millimetres; 0 is unknown, 65535 is at or beyond the format's end.
export function formatDistance(millimetres, scale) {
  const unit = scale === "metric" ? "m" : "rel.";
  if (millimetres === 0) return { text: "unknown", unit: "" };
  if (millimetres === 65535) return { text: "\u2265 65.5", unit };
  return { text: (millimetres / 1000).toFixed(millimetres < 10000 ? 2 : 1), unit };
}

export class DepthPainter {
  #context;
  #image = null;
  #range = null;  // metres at the ends of the colour map, smoothed over frames
  #table = new Uint32Array(65536);

  constructor(canvas, scaleCanvas) {
    this.#context = canvas.getContext("2d", { alpha: false });
    const scale = scaleCanvas.getContext("2d");
    const image = scale.createImageData(256, 1);
    const words = new Uint32Array(image.data.buffer);
    for (let i = 0; i < 256; i++) words[i] = ramp[Math.round((i * (steps - 1)) / 255)];
    scale.putImageData(image, 0, 0);
  }

  // Paints `depth` and returns the range of its colours in metres.
  paint(depth) {
    this.#follow(depth.values);
    const { canvas } = this.#context;
    if (!this.#image || canvas.width !== depth.width || canvas.height !== depth.height) {
      canvas.width = depth.width;
      canvas.height = depth.height;
      this.#image = this.#context.createImageData(depth.width, depth.height);
    }
    const out = new Uint32Array(this.#image.data.buffer);
    for (let i = 0; i < out.length; i++) out[i] = this.#table[depth.values[i]];
    this.#context.putImageData(this.#image, 0, 0);
    return this.#range;
  }

  #follow(values) {
    const sample = values.filter((value, i) => i % 7 === 0 && value !== 0).sort();
    if (sample.length === 0) {
      this.#range ??= { nearest: 0.5, farthest: 20 };
    } else {
      const at = (part) => sample[Math.floor(part * (sample.length - 1))] / 1000;
      const nearest = Math.max(0.03, at(0.02));
      const farthest = Math.max(at(0.98), nearest * 1.5);
      const blend = (from, to) => from * (to / from) ** 0.25;
      this.#range = this.#range === null ? { nearest, farthest } : {
        nearest: blend(this.#range.nearest, nearest),
        farthest: blend(this.#range.farthest, farthest),
      };
    }
    const span = Math.log(this.#range.farthest / this.#range.nearest);
    this.#table[0] = black;
    for (let value = 1; value < 65536; value++) {
      const x = Math.log(value / 1000 / this.#range.nearest) / span;
      this.#table[value] = ramp[Math.round((steps - 1) * Math.min(1, Math.max(0, x)))];
    }
  }
}
