// The exported network in ONNX Runtime.
//
//   node onnxruntime.mjs MODEL.onnx THREADS             times it, as `lcdm-train compare` asks:
//       each line N on standard input runs N frames and answers "WALL CPU", milliseconds of the
//       median frame
//   node onnxruntime.mjs MODEL.onnx INPUT OUTPUT        computes the depth of one image
//
// INPUT and OUTPUT are raw little-endian float32 tensors: [1, 3, H, W] and [1, 1, H, W].
import { readFileSync, writeFileSync } from "node:fs";
import { createInterface } from "node:readline";
import * as ort from "onnxruntime-node";

const [model, first, output] = process.argv.slice(2);
const threads = output ? 1 : Number(first);
const session = await ort.InferenceSession.create(model, {
  executionProviders: ["cpu"],
  graphOptimizationLevel: "all",
  executionMode: "sequential",
  intraOpNumThreads: threads,
  interOpNumThreads: 1,
});
const shape = session.inputMetadata[0].shape;

async function run(values) {
  return (await session.run({ image: new ort.Tensor("float32", values, shape) })).depth.data;
}

function median(values) {
  return values.sort((a, b) => a - b)[Math.floor(values.length / 2)];
}

if (output) {
  const bytes = readFileSync(first);
  const values = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 4);
  const depth = await run(values);
  writeFileSync(output, Buffer.from(depth.buffer, depth.byteOffset, depth.byteLength));
} else {
  const count = shape.reduce((product, extent) => product * extent, 1);
  const image = Float32Array.from({ length: count }, (_, i) => 0.5 + 0.5 * Math.sin(i * 0.37));
  for await (const line of createInterface({ input: process.stdin })) {
    const wall = [];
    const cpu = [];
    for (let i = 0; i < Number(line); i++) {
      const begin = process.hrtime.bigint();
      const used = process.cpuUsage();
      await run(image);
      const { user, system } = process.cpuUsage(used);
      wall.push(Number(process.hrtime.bigint() - begin) * 1e-6);
      cpu.push((user + system) * 1e-3);
    }
    console.log(`${median(wall).toFixed(3)} ${median(cpu).toFixed(3)}`);
  }
}
