// Least and greatest value of every output over pictures, as JSON: {NAME: [LEAST, GREATEST]}.
//
//   node ranges.mjs MODEL.onnx PICTURES     raw little-endian float32 tensors [1, 3, H, W]
import { readFileSync } from "node:fs";
import * as ort from "onnxruntime-node";

const [model, pictures] = process.argv.slice(2);
const session = await ort.InferenceSession.create(model);
const shape = session.inputMetadata[0].shape;
const count = shape.reduce((product, extent) => product * extent, 1);
const bytes = readFileSync(pictures);
const values = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 4);
const ranges = {};
for (let begin = 0; begin < values.length; begin += count) {
  const picture = values.slice(begin, begin + count);
  const outputs = await session.run({ image: new ort.Tensor("float32", picture, shape) });
  for (const [name, { data }] of Object.entries(outputs)) {
    const range = (ranges[name] ??= [Infinity, -Infinity]);
    for (const value of data) {
      range[0] = Math.min(range[0], value);
      range[1] = Math.max(range[1], value);
    }
  }
}
console.log(JSON.stringify(ranges));
