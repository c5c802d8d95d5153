"""What the scripts beside it share: a camera is a dictionary with width, height, fx, fy, cx, cy.

Depth and points are in metres. What strangers pickled is read with Unpickler.
"""
import argparse
import functools
import json
import pathlib
import pickle

import cv2
import numpy


class Unpickler(pickle.Unpickler):
    """Refuses every name that is not in `allowed`, (module, name) -> what to take for it."""

    def __init__(self, file, allowed):
        super().__init__(file)
        self.allowed = allowed

    def find_class(self, module, name):
        if (module, name) not in self.allowed:
            raise pickle.UnpicklingError(f"refused: {module}.{name}")
        return self.allowed[module, name]


def read(path, flags=cv2.IMREAD_COLOR):
    image = cv2.imread(str(path), flags)
    if image is None:
        raise SystemExit(f"{path}: no such picture, or not one that can be read")
    return image


def write(path, image, *options):
    if not cv2.imwrite(str(path), image, *options):
        raise SystemExit(f"{path}: cannot be written: is there room on the disk?")


def camera(width, height, fx, fy, cx, cy):
    return {"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}


def narrowed(colour, of, width):
    """Picture and camera at `width` pixels."""
    height = round(of["height"] * width / of["width"])
    across, down = width / of["width"], height / of["height"]
    small = camera(
        width, height, of["fx"] * across, of["fy"] * down, of["cx"] * across, of["cy"] * down
    )
    return cv2.resize(colour, (width, height), interpolation=cv2.INTER_AREA), small


def fitted(colour, of, depth, width):
    """At most `width` pixels wide, depth by its nearest pixel at the picture's size."""
    if of["width"] > width:
        colour, of = narrowed(colour, of, width)
    size = (of["width"], of["height"])
    return colour, of, cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)


def nearest(points, of, spread=0.0):
    """Depth as the camera sees points (N x 3, metres, its own axes), the nearest of each pixel.

    0 where there is none. A point also falls `spread` / 2 pixels to all four sides of itself.
    """
    points = points[points[:, 2] > 0]
    x = of["fx"] * points[:, 0] / points[:, 2] + of["cx"]
    y = of["fy"] * points[:, 1] / points[:, 2] + of["cy"]
    depth = numpy.full((of["height"], of["width"]), numpy.inf)
    for right, down in ((0, 0), (-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)):
        column = numpy.round(x + right * spread).astype(int)
        row = numpy.round(y + down * spread).astype(int)
        inside = (column >= 0) & (column < of["width"]) & (row >= 0) & (row < of["height"])
        numpy.minimum.at(depth, (row[inside], column[inside]), points[inside, 2])
        if not spread:
            break
    depth[numpy.isinf(depth)] = 0
    return depth


def lzf(packed, size):
    """The `size` bytes that LZF packed: runs of bytes, and copies of what came before."""
    plain, at, to = bytearray(size), 0, 0
    end = len(packed)
    while at < end:
        control = packed[at]
        at += 1
        if control < 32:
            control += 1
            plain[to : to + control] = packed[at : at + control]
            at += control
            to += control
            continue
        length = (control >> 5) + 2
        if length == 9:
            length += packed[at]
            at += 1
        back = ((control & 31) << 8) + packed[at] + 1
        at += 1
        if back >= length:
            plain[to : to + length] = plain[to - back : to - back + length]
        else:
            part = bytes(plain[to - back : to])
            plain[to : to + length] = (part * (length // back + 1))[:length]
        to += length
    return plain


def save_pack(folder, frames, unit, quality):
    """A pack of frames: name, picture, its camera, depth (None: the pack has none).

    `unit` is what 1 means in the files of depth, in metres, `quality` JPEG's.
    """
    (folder / "rgb").mkdir(parents=True, exist_ok=True)
    cameras = {}
    for name, colour, of, depth in frames:
        write(folder / "rgb" / f"{name}.jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if depth is not None:
            (folder / "depth").mkdir(exist_ok=True)
            steps = numpy.clip(numpy.round(depth / unit), 0, 65535).astype(numpy.uint16)
            write(folder / "depth" / f"{name}.png", steps)
        cameras[name] = of
    first = next(iter(cameras.values()))
    intrinsics = dict(first, depth_unit_m=unit)
    if any(of != first for of in cameras.values()):
        intrinsics["frames"] = cameras
    (folder / "intrinsics.json").write_text(json.dumps(intrinsics, indent=1))
    print(f"{folder}: {len(cameras)} frames")


def in_two_parts(frames):
    """Names the frames as two sequences.

    A sequence of 34 frames or more would give its end to validation; all of these are to train.
    """

    @functools.wraps(frames)
    def named(*folders):
        found = list(frames(*folders))
        for number, (_, *rest) in enumerate(found):
            yield f"part{number * 2 // len(found)}_{number:04d}", *rest

    return named


def given_folders(description):
    """What the scripts are called with."""
    options = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument(
        "--checkouts", type=pathlib.Path, required=True, help="folder of the repositories"
    )
    options.add_argument("--output", type=pathlib.Path, required=True, help="folder of the packs")
    return options.parse_args()


def make(description, packs, unit, quality):
    """The scripts' main: packs, each a function of the folders of repositories -> their names."""
    given = given_folders(description)
    for frames, repositories in packs.items():
        folders = [given.checkouts / one for one in repositories]
        absent = [str(folder) for folder in folders if not folder.is_dir()]
        if absent:
            print(f"{frames.__name__}: left out, there is no {', '.join(absent)}")
            continue
        save_pack(given.output / frames.__name__, frames(*folders), unit, quality)
