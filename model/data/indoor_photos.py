#!/usr/bin/env python3
"""Makes the pack indoor_photos, 4,035 photographs of rooms without depth, from public repositories.

    git clone https://github.com/emanhamed/Houses-dataset    # and the others; all are needed
    python3 model/data/indoor_photos.py --checkouts . --output ../rooms
    python3 model/data/photo_maps.py ../rooms/indoor_photos  # what must be there before: --help

Pictures, repository at commit: licence

    1911  SilviuBR24/room-classification 0eca0b2: MIT; Places365's, for research and education
    1577  emanhamed/Houses-dataset 5e14821: none stated, asks to be cited (arXiv 1609.08399)
     352  MiguelARD/DoorDetect-Dataset 1db107f: none stated; of Open Images and MCIndoor20000
      66  Stam21/GaussianSplattingExample ec6340f: that of 3D Gaussian Splatting, research
      58  PavanGavit/test cb0ad38: none stated
      28  Chapapa78/ProjetSLAM 1f40205: none stated
      22  ZhehaoLu/RGB-D-SLAM 914ea44: none stated
      11  Scodive/Data 4495a8a: none stated
      10  ConsideringName/upload-files b51e06b: none stated

indoor_photos.txt beside this names them, REPOSITORY/PATH a line: seen on contact sheets; without
those that show no place, close-ups, drawings, grey, blurred and framed ones, and those much like
another. The middle 4:3 part of each at 480x360; Places365's were pressed into squares and are
stretched back, which is right for those that lay. Their cameras are not known: the file's
intrinsics are a guess. Needs python3-opencv.
"""
import json
import pathlib

import cv2
import numpy

import packs

WIDTH, HEIGHT = 480, 360
QUALITY = 92  # of JPEG
WHITE, BLACK = 243, 8
FRAME = 0.7  # of a row or column is white or black: a frame's
SQUEEZED = "room-classification"
FOCAL = 0.9  # of the width, a guess


def unframed(picture):
    """Without a white or black frame of at most a fifth on each side."""
    for _ in range(2):  # rows, then columns
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        plain = numpy.maximum((grey > WHITE).mean(1), (grey < BLACK).mean(1))
        inside = numpy.flatnonzero(plain < FRAME)
        first, last = (inside[0], inside[-1] + 1) if len(inside) else (0, len(plain))
        height = picture.shape[0]
        picture = picture[min(first, height // 5) : max(last, height - height // 5)]
        picture = cv2.transpose(picture)
    return picture


def middle(picture):
    """Its largest part of the pack's shape."""
    height, width = picture.shape[:2]
    if width * HEIGHT > height * WIDTH:
        across = round(height * WIDTH / HEIGHT)
        return picture[:, (width - across) // 2 :][:, :across]
    down = round(width * HEIGHT / WIDTH)
    return picture[(height - down) // 2 :][:down]


def photograph(path, squeezed):
    picture = packs.read(path)
    if not squeezed:
        picture = middle(unframed(picture))
    way = cv2.INTER_AREA if picture.shape[1] >= WIDTH else cv2.INTER_CUBIC
    return cv2.resize(picture, (WIDTH, HEIGHT), interpolation=way)


def main():
    given = packs.given_folders(__doc__)
    folder = given.output / "indoor_photos"
    (folder / "rgb").mkdir(parents=True, exist_ok=True)
    names = pathlib.Path(__file__).with_suffix(".txt").read_text().splitlines()
    for number, name in enumerate(names):
        picture = photograph(given.checkouts / name, name.startswith(SQUEEZED))
        file = folder / "rgb" / f"{number:06d}.jpg"
        packs.write(file, picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    focal, cx, cy = FOCAL * WIDTH, (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    camera = packs.camera(WIDTH, HEIGHT, focal, focal, cx, cy)
    (folder / "intrinsics.json").write_text(json.dumps(camera, indent=1))
    print(f"{folder}: {len(names)} pictures")


if __name__ == "__main__":
    main()
