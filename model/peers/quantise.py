#!/usr/bin/env python3
"""An exported network for ONNX Runtime in int8, to compare the engine's with.

    lcdm-train export --model lcdm-xs.safetensors --onnx xs.onnx
    python3 model/peers/quantise.py xs.onnx PICTURES xs_int8.onnx

In bytes, where that made ONNX Runtime faster: linear layers by ranges of each frame, 3x3
convolutions of 48 and more channels to 32 and more by the ranges that a few dozen PICTURES (a
folder) have; weights by a scale for each column or output. 1x1 and depthwise convolutions, the
first and the last layers made it slower or less exact. Needs python3-onnx and python3-opencv, and
Node's onnxruntime-node beside this file for the ranges.
"""
import argparse
import json
import pathlib
import subprocess
import tempfile

import cv2
import numpy
import onnx
from onnx import helper, numpy_helper

HERE = pathlib.Path(__file__).resolve().parent


def kind_of(node, constants):
    """'linear', 'convolution', or None: stays in floats."""
    weights = constants.get(node.input[1]) if len(node.input) > 1 else None
    if weights is None:
        return None
    if node.op_type == "MatMul":
        return "linear"
    if node.op_type == "Conv" and weights.shape[2] == 3:
        outputs, inputs = weights.shape[:2]
        return "convolution" if outputs >= 32 and inputs >= 48 else None
    return None


def ranges_of(model, names, pictures):
    """Least and greatest value of each tensor over the pictures."""
    tapped = onnx.ModelProto()
    tapped.CopyFrom(model)
    tapped.graph.output.extend(helper.make_empty_tensor_value_info(name) for name in names)
    height, width = (d.dim_value for d in model.graph.input[0].type.tensor_type.shape.dim[2:])
    with tempfile.TemporaryDirectory() as folder:
        onnx.save(tapped, f"{folder}/tapped.onnx")
        with open(f"{folder}/pictures", "wb") as file:
            for path in sorted(p for p in pictures.iterdir() if p.suffix in (".jpg", ".png")):
                picture = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
                picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
                file.write((picture.astype(numpy.float32) / 255).transpose(2, 0, 1).tobytes())
        command = ["node", HERE / "ranges.mjs", f"{folder}/tapped.onnx", f"{folder}/pictures"]
        return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


class Quantiser:
    def __init__(self, graph, ranges):
        self.graph = graph
        self.ranges = ranges
        self.constants = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
        self.nodes = []
        self.made = set()

    def constant(self, name, values):
        if name not in self.made:
            self.graph.initializer.append(numpy_helper.from_array(numpy.asarray(values), name))
            self.made.add(name)
        return name

    def node(self, kind, inputs, outputs, **attributes):
        self.nodes.append(helper.make_node(kind, inputs, outputs, **attributes))
        return outputs[0]

    def bytes_of(self, name, axis):
        """The weights as bytes and the scale of each index along `axis`."""
        weights = self.constants[name]
        others = tuple(i for i in range(weights.ndim) if i != axis)
        scales = (numpy.abs(weights).max(axis=others, keepdims=True) / 127).astype(numpy.float32)
        values = numpy.round(weights / numpy.maximum(scales, 1e-12)).astype(numpy.int8)
        return self.constant(f"{name}.bytes", values), scales.reshape(-1)

    def step_of(self, name):
        """Of 256 in its range; and where zero, which is in it, lies."""
        low, high = (min(0, self.ranges[name][0]), max(0, self.ranges[name][1]))
        step = max((high - low) / 255, 1e-9)
        return step, round(-low / step)

    def rounded(self, name, source, output):
        """`output` is `source` in bytes and back, by the range of `name`."""
        if output in self.made:
            return output
        self.made.add(output)
        step, zero = self.step_of(name)
        scale = [
            self.constant(f"{output}.step", numpy.float32(step)),
            self.constant(f"{output}.zero", numpy.uint8(zero)),
        ]
        stored = self.node("QuantizeLinear", [source, *scale], [f"{output}.bytes"])
        return self.node("DequantizeLinear", [stored, *scale], [output])

    def linear(self, node):
        name, output = node.input[0], node.output[0]
        if f"{name}.range" not in self.made:
            self.made.add(f"{name}.range")
            outputs = [f"{name}.dynamic", f"{name}.range", f"{name}.offset"]
            self.node("DynamicQuantizeLinear", [name], outputs)
        weights, scales = self.bytes_of(node.input[1], axis=1)
        scales = self.constant(f"{node.input[1]}.scales", scales)
        inputs = [f"{name}.dynamic", weights, f"{name}.offset"]
        whole = self.node("MatMulInteger", inputs, [f"{output}.sums"])
        floats = self.node("Cast", [whole], [f"{output}.floats"], to=onnx.TensorProto.FLOAT)
        scale = self.node("Mul", [f"{name}.range", scales], [f"{output}.scales"])
        self.node("Mul", [floats, scale], [output])

    def convolution(self, node):
        """As ONNX Runtime's own tool writes it: what lies between dequantising and quantising nodes
        becomes one kernel."""
        (source, kernel), output = node.input[:2], node.output[0]
        weights, scales = self.bytes_of(kernel, axis=0)
        scale = self.constant(f"{kernel}.scales", scales)
        inputs = [
            self.rounded(source, source, f"{source}.rounded"),
            self.node("DequantizeLinear", [weights, scale], [f"{kernel}.rounded"], axis=0),
        ]
        for bias in node.input[2:]:
            steps = (scales * self.step_of(source)[0]).astype(numpy.float32)
            sums = numpy.round(self.constants[bias] / numpy.maximum(steps, 1e-12))
            stored = self.constant(f"{bias}.sums", sums.astype(numpy.int32))
            steps = self.constant(f"{bias}.steps", steps)
            inputs.append(
                self.node("DequantizeLinear", [stored, steps], [f"{bias}.rounded"], axis=0)
            )
        node.input[:] = inputs
        node.output[0] = f"{output}.exact"
        self.nodes.append(node)
        self.rounded(output, node.output[0], output)


def main():
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("model", type=pathlib.Path)
    options.add_argument("pictures", type=pathlib.Path)
    options.add_argument("output", type=pathlib.Path)
    options = options.parse_args()
    model = onnx.load(options.model)
    nodes = list(model.graph.node)
    constants = {t.name: numpy_helper.to_array(t) for t in model.graph.initializer}
    kinds = [kind_of(node, constants) for node in nodes]
    convolutions = [node for node, kind in zip(nodes, kinds) if kind == "convolution"]
    names = {name for node in convolutions for name in (node.input[0], node.output[0])}
    quantiser = Quantiser(model.graph, ranges_of(model, sorted(names), options.pictures))
    for node, kind in zip(nodes, kinds):
        if kind == "linear":
            quantiser.linear(node)
        elif kind == "convolution":
            quantiser.convolution(node)
        else:
            quantiser.nodes.append(node)
    del model.graph.node[:]
    model.graph.node.extend(quantiser.nodes)
    used = {name for node in quantiser.nodes for name in node.input}
    kept = [t for t in model.graph.initializer if t.name in used]
    del model.graph.initializer[:]
    model.graph.initializer.extend(kept)
    onnx.save(model, options.output)
    print(f"{options.output}: {kinds.count('linear')} linear layers and {len(convolutions)} "
          f"convolutions in bytes")


if __name__ == "__main__":
    main()
