#!/usr/bin/env python3
"""Makes packs of the 1,449 labelled frames of NYU Depth V2 (Silberman et al. 2012: 464 rooms, a Kinect).

    git clone https://github.com/markshih91/refinenet_pytorch    # the frames, with depth in 8 bit
    git clone https://github.com/prs-eth/Marigold                # whose lists name each frame's scene and split
    python3 model/data/nyu_rooms.py --frames refinenet_pytorch/data --output ../rooms \\
        --lists Marigold/data_split/nyu_depth/labeled

nyu_train are the 795 official training frames (249 scenes), nyu_left_out and nyu_test a third and two thirds of the
other scenes but four. Needs python3-opencv. Who has the authors' own .mat needs none of this: form = "nyu" reads that.

Depth is there as floor(25.5 * metres), the Kinect's holes filled: here smoothed within each step of 39 mm (beside one
frame's 16 bits: 9 mm root mean square). Colour and depth are stored mirrored. The authors name no licence; such use
is research.
"""
import argparse
import hashlib
import json
import pathlib
import re

import cv2
import numpy

import packs

STEPS_PER_METRE = 25.5
CLIPPED = 254  # from 10 m on
TOP, BOTTOM, LEFT, RIGHT = 45, 471, 41, 601  # without the white border
# What the four clips clips_deepv2d/nyu_* show (found by matching points): trained on, so neither left out nor test.
IN_CLIPS = {"living_room_0079", "classroom_0023", "playroom_0008", "bathroom_0009"}
MARGIN = 8  # of what is cropped, for the filter
FX, FY, CX, CY = 518.857901, 519.469611, 325.582449 - 1, 253.736166 - 1  # of the set's own tools, from 0


def scenes(lists):
    """Frame number -> (split, scene)."""
    found = {}
    for split in ("train", "test"):
        for line in (lists / f"filename_list_{split}.txt").read_text().splitlines():
            if line.strip():
                _, scene, name = line.split()[0].split("/")
                found[int(re.match(r"rgb_(\d+)", name)[1])] = (split, scene)
    return found


def pack_of(split, scene):
    if split == "train":
        return "nyu_train"
    digest = int(hashlib.md5(scene.encode(), usedforsecurity=False).hexdigest(), 16)
    return "nyu_test" if digest % 3 else "nyu_left_out"


def millimetres(steps):
    """Depth smoothed as far as the steps leave open; 0 where it was clipped."""
    low = steps.astype(numpy.float32)
    smooth = low + 0.5
    for _ in range(4):
        smooth = numpy.clip(cv2.bilateralFilter(smooth, 9, 1.2, 4.0), low, low + 1)
    depth = numpy.round(smooth / STEPS_PER_METRE * 1000).astype(numpy.uint16)
    depth[steps >= CLIPPED] = 0
    return depth


def read(path, flags):
    image = cv2.imread(str(path), flags)
    if image is None:
        raise SystemExit(f"{path}: no such picture; --frames is the folder with nyu_images and nyu_depths")
    return image[:, ::-1]


def convert(frames, number, folder, name):
    colour = read(frames / "nyu_images" / f"{number - 1}.jpg", cv2.IMREAD_COLOR)
    steps = read(frames / "nyu_depths" / f"{number - 1}.png", cv2.IMREAD_GRAYSCALE)
    wide = steps[TOP - MARGIN : BOTTOM + MARGIN, LEFT - MARGIN : RIGHT + MARGIN]
    depth = millimetres(numpy.ascontiguousarray(wide))[MARGIN:-MARGIN, MARGIN:-MARGIN]
    packs.write(folder / "rgb" / f"{name}.jpg", colour[TOP:BOTTOM, LEFT:RIGHT], [cv2.IMWRITE_JPEG_QUALITY, 92])
    packs.write(folder / "depth" / f"{name}.png", depth)


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--frames", type=pathlib.Path, required=True, help="folder with nyu_images and nyu_depths")
    options.add_argument("--lists", type=pathlib.Path, required=True, help="folder with filename_list_{train,test}.txt")
    options.add_argument("--output", type=pathlib.Path, required=True, help="folder of the packs")
    given = options.parse_args()
    intrinsics = {
        "width": RIGHT - LEFT,
        "height": BOTTOM - TOP,
        "fx": FX,
        "fy": FY,
        "cx": CX - LEFT,
        "cy": CY - TOP,
        "depth_unit_m": 0.001,
    }
    for number, (split, scene) in sorted(scenes(given.lists).items()):
        if scene in IN_CLIPS:
            continue
        folder = given.output / pack_of(split, scene)
        for part in ("rgb", "depth"):
            (folder / part).mkdir(parents=True, exist_ok=True)
        (folder / "intrinsics.json").write_text(json.dumps(intrinsics))
        convert(given.frames, number, folder, f"{scene}_{number:04d}")


if __name__ == "__main__":
    main()
