#!/usr/bin/env python3
"""Betters a teacher's maps of KITTI's pictures: METER's averaged with RT-MonoDepth-S's.

    git clone https://github.com/Janith-Chamikara/jetson_skyvision
    cd jetson_skyvision
    git checkout 4b20aa8
    git checkout 631c48e2 -- weights/RTMonoDepth/s/ms_640_192/encoder.pth
    cd ..
    python3 model/data/kitti_maps.py --weights jetson_skyvision/weights/RTMonoDepth/s \
        ../rooms/driving_kitti_object

For each pack with teacher_meter/NAME.png (16 bit, 1/256 m) writes teacher_kitti/NAME.png of the
same kind: the mean in log depth of METER's map and of RT-MonoDepth-S's two checkpoints, m (from
video) and ms (and stereo), each divided by its median before, times METER's median. What it gains,
median-scaled AbsRel / delta1 of METER, of RT-MonoDepth-S and of the mean: .148 / .779, .145 / .810
and .136 / .817 on nine KITTI object frames with a laser's depth (kitti_left_out); on DDAD AbsRel
.341, .358 and .337.

RT-MonoDepth-S (Feng et al. 2024, Ecalpal/RT-MonoDepth) has 1.2 million weights, under Monodepth2's
licence: not for commerce. It learned from KITTI raw (CC BY-NC-SA 3.0). Needs python3-opencv and no
torch.
"""
import argparse
import collections
import functools
import math
import pathlib
import pickle
import zipfile

import cv2
import numpy

import packs

WIDTH, HEIGHT = 640, 192  # what it was trained at
UNIT = 1 / 256
NEAREST, FARTHEST = 0.1, 100  # of its output, 1 / (0.01 + 9.99 * sigmoid)
METER_NEAREST = 0.1  # metres; a zero would have no inverse
CHECKPOINTS = ("m_640_192", "ms_640_192")


def tensor(storage, offset, size, stride, *_):
    whole = storage[offset : offset + math.prod(size)].reshape(size)
    if tuple(stride) != tuple(step // whole.itemsize for step in whole.strides):
        raise pickle.UnpicklingError("refused: a tensor that does not lie in one piece")
    return whole


class Weights(packs.Unpickler):
    """Reads what torch.save wrote, and nothing that could run: the files are a stranger's."""

    ALLOWED = {
        ("collections", "OrderedDict"): collections.OrderedDict,
        ("torch._utils", "_rebuild_tensor_v2"): tensor,
        ("torch", "FloatStorage"): numpy.float32,
    }

    def __init__(self, archive, list_name):
        super().__init__(archive.open(list_name), self.ALLOWED)
        self.archive, self.folder = archive, list_name.removesuffix("data.pkl")

    def persistent_load(self, pid):
        _, kind, key, *_ = pid
        return numpy.frombuffer(self.archive.read(f"{self.folder}data/{key}"), kind)


def weights_of(path):
    with zipfile.ZipFile(path) as archive:
        name = next(one for one in archive.namelist() if one.endswith("data.pkl"))
        return Weights(archive, name).load()


def convolved(x, weights, name, stride=1, edge="constant"):
    weight = weights[f"{name}.weight"]
    size = weight.shape[2]
    margin = size // 2
    x = numpy.pad(x, ((0, 0), (margin, margin), (margin, margin)), mode=edge)
    windows = numpy.lib.stride_tricks.sliding_window_view(x, (size, size), axis=(1, 2))
    y = numpy.tensordot(weight, windows[:, ::stride, ::stride], axes=((1, 2, 3), (0, 3, 4)))
    return y + weights[f"{name}.bias"][:, None, None] if f"{name}.bias" in weights else y


def leaky(x):
    return numpy.where(x > 0, x, 0.1 * x)


def elu(x):
    return numpy.where(x > 0, x, numpy.expm1(numpy.minimum(x, 0)))


def rt_monodepth(encoder, decoder, colour):
    """RT-MonoDepth-S: depth at 640x192, in a unit of its own."""
    small = cv2.resize(colour, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    x = cv2.cvtColor(small, cv2.COLOR_BGR2RGB).transpose(2, 0, 1) / numpy.float32(255)
    x = (x - numpy.float32(0.45)) / numpy.float32(0.225)
    x = numpy.maximum(convolved(x, encoder, "conv1", 2), 0)
    for level in range(3):
        x = leaky(convolved(x, encoder, f"convs.{level}.0", 2))
        x = leaky(convolved(x, encoder, f"convs.{level}.2"))
    for step in range(0, 8, 2):
        x = elu(convolved(x, decoder, f"decoder.{step}.conv", edge="reflect"))
        x = x.repeat(2, axis=1).repeat(2, axis=2)
        x = elu(convolved(x, decoder, f"decoder.{step + 1}.conv", edge="reflect"))
    sigmoid = 1 / (1 + numpy.exp(-convolved(x, decoder, "decoder.8.conv3")[0]))
    return 1 / (1 / FARTHEST + (1 / NEAREST - 1 / FARTHEST) * sigmoid)


def meter_depth(path):
    depth = numpy.maximum(packs.read(path, cv2.IMREAD_UNCHANGED) * UNIT, METER_NEAREST)
    return 1 / cv2.resize(1 / depth, (WIDTH, HEIGHT))


def mean_of(meter, others):
    logs = [numpy.log(one / numpy.median(one)) for one in (meter, *others)]
    return numpy.exp(numpy.mean(logs, axis=0)) * numpy.median(meter)


def improve(pack, networks):
    pictures = pack / "rgb" if (pack / "rgb").is_dir() else pack
    maps = pack / "teacher_kitti"
    maps.mkdir(exist_ok=True)
    for path in sorted(pictures.iterdir()):
        if path.suffix not in (".jpg", ".png"):
            continue
        colour = packs.read(path)
        meter = meter_depth(pack / "teacher_meter" / f"{path.stem}.png")
        depth = mean_of(meter, [network(colour) for network in networks])
        steps = numpy.clip(numpy.round(depth / UNIT), 1, 65535).astype(numpy.uint16)
        packs.write(maps / f"{path.stem}.png", steps)
    print(f"{maps}: {len(list(maps.iterdir()))} maps")


def main():
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument(
        "--weights", type=pathlib.Path, required=True, help="folder of m_640_192 and ms_640_192"
    )
    options.add_argument(
        "packs", type=pathlib.Path, nargs="+", help="packs, or folders of pictures"
    )
    given = options.parse_args()
    networks = []
    for name in CHECKPOINTS:
        files = [weights_of(given.weights / name / f"{part}.pth") for part in ("encoder", "depth")]
        networks.append(functools.partial(rt_monodepth, *files))
    for pack in given.packs:
        improve(pack, networks)


if __name__ == "__main__":
    main()
