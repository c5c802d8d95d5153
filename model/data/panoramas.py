#!/usr/bin/env python3
"""Makes the pack panorama_rooms, views into CC0 panoramas of rooms, without depth.

    git clone https://github.com/gkjohnson/3d-demo-data    # and the others; all are needed
    python3 model/data/panoramas.py --checkouts . --output ../rooms

Poly Haven gives its panoramas as CC0; they lie in repositories of viewers and games, known by
their names (not all of these say where theirs are from):

    17  gkjohnson/3d-demo-data
     4  wonglok/effectnode-desk-gui, and one each in wonglok/agape-home, /demo-agape-land-gui,
        /glb-editor and /my-glb
     3  each: facebookresearch/habitat-sim, naver/egjs-view3d, pmndrs/drei-assets,
        promiseLC/threejs_demo
     1  each: 0beqz/realism-effects, AlvarezAriel/threejs-playground,
        Archana-Patukuri/website_sofa_model, bornfree/talking_avatar, pmndrs/examples

panoramas.txt beside this names them, a repository, its commit and a file a line: rooms, halls and
workshops, without studios that are only light. Twelve views all around each, from level to turned
down as a hand or a robot holds a camera, exposed so that half of a view is darker than middle grey.
Most panoramas are 1024 wide, so the views are a little soft. Needs git and python3-opencv.
"""
import os
import pathlib
import subprocess

os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(1 << 26)
import cv2
import numpy

import packs

WIDTH, HEIGHT = 320, 240
VIEWS = 12
QUALITY = 92  # of JPEG
NARROWEST, WIDEST = 62, 82  # degrees across
LOWEST, HIGHEST = -30, 8  # degrees of pitch
ROLL = 4  # degrees, standard deviation
MIDDLE = 0.18  # of white, linear: what half of a view is darker than


def read(folder, commit, path):
    """In linear light."""
    command = ["git", "-C", str(folder), "show", f"{commit}:{path}"]
    shown = subprocess.run(command, capture_output=True)
    if shown.returncode:
        raise SystemExit(f"{folder}: {shown.stderr.decode().strip()}: is the clone whole?")
    data = numpy.frombuffer(shown.stdout, numpy.uint8)
    panorama = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    if panorama is None:
        raise SystemExit(f"{folder}: {path} is not a picture that can be read")
    if panorama.dtype == numpy.uint8:
        panorama = (panorama / 255.0) ** 2.2
    return numpy.nan_to_num(panorama.astype(numpy.float32), posinf=1e4)


def turned(yaw, pitch, roll):
    """Of a camera's axes (right, down, forward) into the panorama's."""
    about = ([0, yaw, 0], [pitch, 0, 0], [0, 0, roll])
    first, second, third = (cv2.Rodrigues(numpy.array(axis, float))[0] for axis in about)
    return first @ second @ third


def view(panorama, focal, rotation):
    """The panorama as a camera of WIDTH x HEIGHT sees it."""
    x, y = numpy.meshgrid(numpy.arange(WIDTH), numpy.arange(HEIGHT))
    x, y = x - (WIDTH - 1) / 2, y - (HEIGHT - 1) / 2
    rays = numpy.stack([x, y, numpy.full_like(x, focal)], -1) @ rotation.T
    rays /= numpy.linalg.norm(rays, axis=-1, keepdims=True)
    height, width = panorama.shape[:2]
    across = (numpy.arctan2(rays[..., 0], rays[..., 2]) / (2 * numpy.pi) + 0.5) * width - 0.5
    down = (numpy.arcsin(rays[..., 1]) / numpy.pi + 0.5) * height - 0.5
    maps = across.astype(numpy.float32), down.astype(numpy.float32)
    return cv2.remap(panorama, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def developed(linear):
    """8 bits of linear light, exposed by its median, with a shoulder (Reinhard 2002, Eq. 4)."""
    exposed = numpy.maximum(linear * (MIDDLE / max(numpy.median(linear.mean(-1)), 1e-6)), 0)
    shoulder = exposed * (1 + exposed / 16) / (1 + exposed)
    grey = (1 + MIDDLE / 16) / (1 + MIDDLE)
    return numpy.round(255 * numpy.clip(shoulder / grey, 0, 1) ** (1 / 2.2)).astype(numpy.uint8)


def frames(checkouts):
    for line in pathlib.Path(__file__).with_suffix(".txt").read_text().splitlines():
        repository, commit, path = line.split()
        panorama = read(checkouts / repository, commit, path)
        name = pathlib.Path(path)
        random = numpy.random.default_rng(sum(name.name.encode()))
        for number in range(VIEWS):
            across = numpy.radians(random.uniform(NARROWEST, WIDEST))
            focal = WIDTH / 2 / numpy.tan(across / 2)
            yaw = 2 * numpy.pi * (number + random.uniform()) / VIEWS
            pitch = numpy.radians(random.uniform(LOWEST, HIGHEST))
            roll = numpy.radians(random.normal(0, ROLL))
            picture = developed(view(panorama, focal, turned(yaw, pitch, roll)))
            camera = packs.camera(WIDTH, HEIGHT, focal, focal, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
            yield f"{name.stem.replace('_', '-')}_{number}", picture, camera, None


def main():
    given = packs.given_folders(__doc__)
    packs.save_pack(given.output / "panorama_rooms", frames(given.checkouts), 1, QUALITY)


if __name__ == "__main__":
    main()
