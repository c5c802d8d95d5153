#!/usr/bin/env python3
"""Makes packs of rooms, most with a depth camera's depth, from samples in public repositories.

    git clone https://github.com/CMU-AI-Maker-Space/aims-slam    # one, some or all of these
    python3 model/data/public_rooms.py --checkouts . --output ../rooms

Pack, frames, repository at commit: licence

    realsense_floor   51  CMU-AI-Maker-Space/aims-slam 988ed2e: MIT
    xtion_chair       62  Joao-Tiago-Almeida/Minimisation-Tree-from-a-set-of-RGB-D-images ca530e1:
                          none stated
    xtion_mixed       48  rubenftgd/IPV 518b717: none stated
    xtion_labs        32  luislopes1997/TrackingMovingObjects_PIV c2d851f: none stated
    iphone_desk       56  liwuaa/ImageRelocation 939ddec: none stated
    kinect_classroom   9  rahulgautam21/Robot-Localization-using-Experience-Based-Localization-and-
                          Visual-Odometry 05bdd8a: none stated
    tum_desk           2  gaoxiang12/slambook2 e62d9cd: MIT; TUM RGB-D itself CC BY 4.0
    scannet_pair       2  facebookresearch/TemporallyConsistentDepth be85390: CC BY-NC 4.0;
                          ScanNet's own terms, research
    replica_apartment0 252  Chialiang86/Semantic-Mapping-Framework ae0026b: none stated; Replica's own
                          terms, research
    replica_office0   27  Aadit-Munjal/CSCI5561_Project 438a6f0: none stated; the same
    tables_left_out    9  NVlabs/UnseenObjectClustering f5a00c7: NVIDIA's, not for commerce
                       5  NVlabs/PoseCNN-PyTorch f7d28f2: the same

Depth in the files is millimetres of what a depth camera saw. Where that camera is not the
picture's, it is turned into it: the nearest point of each pixel, single holes filled, what shines
through between nearer points taken out. Pictures are at most 640 wide. Needs python3-opencv and
python3-scipy.
"""
import itertools
import re

import cv2
import numpy
import scipy.io

import packs

UNIT = 0.001
QUALITY = 92  # of JPEG
WIDTH, HEIGHT = 640, 480
SHINES_THROUGH = 1.08  # times the median of its 3 x 3 pixels: a point of what is behind

# The ASUS Xtion of Instituto Superior Tecnico, Lisbon, from whose students' work the xtion_* packs
# are: both cameras, and the turn and shift from depth to colour. The repositories have the numbers.
XTION_DEPTH = packs.camera(WIDTH, HEIGHT, 567.89559438, 568.85567344, 312.12398178, 242.56947173)
XTION = packs.camera(WIDTH, HEIGHT, 534.28561536, 534.74519931, 309.56737553, 243.07235825)
XTION_TURN = numpy.array(
    [
        [0.999993566, 3.02622509e-05, 3.58710545e-03],
        [-2.68324181e-05, 0.999999542, -9.56200394e-04],
        [-3.58713275e-03, 9.56097990e-04, 0.999993109],
    ]
)
XTION_SHIFT = numpy.array([-0.02630589, 0.00028027, -0.00077569])

# Intel's D435 of aims-slam, which has no calibration: nominal depth camera and baseline; with this
# colour camera edges of depth meet edges of colour best (focal lengths sure to 3 %).
D435_DEPTH = packs.camera(WIDTH, HEIGHT, 385.0, 385.0, 321.0, 237.0)
D435 = packs.camera(WIDTH, HEIGHT, 604.0, 604.0, 320.0, 232.0)
D435_SHIFT = numpy.array([0.015, 0, 0])
D435_FARTHEST = 6000  # mm; stereo over so short a baseline tells little beyond

# An iPhone's, upright. Not stated: with 440 to 475, walls, desk and monitor meet at right angles.
IPHONE = packs.camera(480, 640, 455.0, 455.0, 240.0, 320.0)
SURE = 100  # the highest of its three grades of confidence
IPHONE_NEAREST = 200  # mm
IPHONE_SHARE = 0.5  # of the pixels must be sure

CLASSROOM = packs.camera(WIDTH, HEIGHT, 532.5695, 531.5411, 319.5, 239.5)
CLASSROOM_FRAMES = (1, 3, 4, 5, 7, 13, 16, 19, 22)  # the others all but repeat these
TUM_FREIBURG2 = packs.camera(WIDTH, HEIGHT, 520.9, 521.0, 325.1, 249.7)
TUM_STEPS = 5  # a millimetre
SCANNET_DEPTH = packs.camera(WIDTH, HEIGHT, 577.870605, 577.870605, 319.5, 239.5)
SCANNET = packs.camera(1296, 968, 1170.187988, 1170.187988, 647.75, 483.75)
SCANNET_FRAMES = (0, 10)  # of 0 to 10, which are neighbours
APARTMENT = packs.camera(512, 512, 256.0, 256.0, 255.5, 255.5)  # 90 degrees
APARTMENT_UNIT = 10 / 65535  # metres
APARTMENT_NEAREST, APARTMENT_SHARE = 0.6, 0.5  # metres, in the middle; or the camera is in a wall
OFFICE = packs.camera(1200, 680, 600.0, 600.0, 599.5, 339.5)
UOC = packs.camera(WIDTH, HEIGHT, 612.937, 613.173, 322.549, 248.158)
POSECNN = packs.camera(WIDTH, HEIGHT, 618.01727, 618.00336, 312.37695, 232.37531)

DARK = 50  # grey level, on average; aims-slam's first picture is darker
FLOOR_MOVED, LABS_MOVED = 9, 4  # grey levels; less is the same view again
LABS_MOST = 40  # of one camera, which stands still while people walk about


def registered(millimetres, of_depth, of_colour, turn=numpy.eye(3), shift=numpy.zeros(3)):
    """The depth camera's millimetres as metres that the colour camera sees."""
    row, column = numpy.nonzero(millimetres)
    z = millimetres[row, column] * UNIT
    x = (column - of_depth["cx"]) / of_depth["fx"] * z
    y = (row - of_depth["cy"]) / of_depth["fy"] * z
    points = numpy.stack([x, y, z], axis=1) @ turn.T + shift
    spread = max(0.0, of_colour["fx"] / of_depth["fx"] - 1)  # or a finer picture is left with gaps
    depth = numpy.round(packs.nearest(points, of_colour, spread) / UNIT).astype(numpy.uint16)
    median = cv2.medianBlur(depth, 3)
    depth = numpy.where(depth == 0, median, depth)
    return numpy.where((median > 0) & (depth > median * SHINES_THROUGH), 0, depth) * UNIT


def from_xtion(millimetres):
    return registered(millimetres, XTION_DEPTH, XTION, XTION_TURN, XTION_SHIFT)


def millimetres_of(path):
    if path.suffix == ".mat":
        return scipy.io.loadmat(str(path))["depth_array"]
    return packs.read(path, cv2.IMREAD_UNCHANGED)


def numbered(folder, pattern):
    """Number at its end -> file."""
    return {int(re.search(r"\d+$", path.stem)[0]): path for path in folder.glob(pattern)}


def pairs(folder, colours, depths):
    """Number, picture and millimetres of what is there of both."""
    pictures, maps = numbered(folder, colours), numbered(folder, depths)
    for number in sorted(pictures.keys() & maps.keys()):
        yield number, packs.read(pictures[number]), millimetres_of(maps[number])


def moved(frames, least):
    """Without those that look like the last one kept before them."""
    before = None
    for number, colour, depth in frames:
        grey = cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)
        grey = cv2.resize(grey, (64, 48), interpolation=cv2.INTER_AREA).astype(float)
        if before is None or numpy.abs(grey - before).mean() >= least:
            before = grey
            yield number, colour, depth


@packs.in_two_parts
def realsense_floor(folder):
    frames = pairs(folder / "data", "rgb/*.png", "depth/*.png")
    frames = moved((one for one in frames if one[1].mean() >= DARK), FLOOR_MOVED)
    for number, colour, depth in itertools.islice(frames, 0, None, 2):
        depth = numpy.where(depth > D435_FARTHEST, 0, depth)
        depth = registered(depth, D435_DEPTH, D435, shift=D435_SHIFT)
        yield f"{number:06d}", colour, D435, depth


@packs.in_two_parts
def xtion_chair(folder):
    project = folder / "Final_project"
    for number, colour, depth in itertools.chain(
        pairs(project / "hobbesquiet", "rgb/*.jpg", "depth/*.png"),
        pairs(project / "office", "rgb/*.png", "depth/*.mat"),
    ):
        yield f"{number:06d}", colour, XTION, from_xtion(depth)


@packs.in_two_parts
def xtion_mixed(folder):
    books = folder / "Projecto/parte2/TODOS_OS_SETS_IMAGENS"
    rooms = folder / "Projecto/parte1/Projecto_Parte1"
    sets = [(books / "book_seq2/test", 3), (books / "booksnewseq/testing1", 3)]  # videos
    sets += [(books / "booksnewseq/training", 1)]
    sets += [(rooms / f"Dataset{number}", 1) for number in (1, 2, 3, 4)]
    for place, step in sets:
        frames = pairs(place, "rgb*.png", "depth*.mat")
        for number, colour, depth in itertools.islice(frames, 0, None, step):
            yield f"{number:06d}", colour, XTION, from_xtion(depth)


def xtion_labs(folder):
    for name, place, colours, depths, step in (
        ("images1", "images1", "images*.jpg", "images*.mat", 4),
        ("images2cam1", "images2", "rgb_image1_*.png", "depth1_*.mat", 1),
        ("images2cam2", "images2", "rgb_image2_*.png", "depth2_*.mat", 1),
        ("images3cam1", "images3", "rgb_image1_*.png", "depth1_*.mat", 1),
        ("images3cam2", "images3", "rgb_image2_*.png", "depth2_*.mat", 1),
        ("images4", "images4", "images*.jpg", "images*.mat", 4),
    ):
        frames = moved(pairs(folder / place, colours, depths), LABS_MOVED)
        for number, colour, depth in itertools.islice(frames, 0, LABS_MOST, step):
            yield f"{name}_{number:06d}", colour, XTION, from_xtion(depth)


@packs.in_two_parts
def iphone_desk(folder):
    confidences = numbered(folder, "confidence/*.png")
    size = (IPHONE["width"], IPHONE["height"])
    for number, colour, depth in pairs(folder, "query/rgb/*.jpg", "depth/*.png"):
        sure = packs.read(confidences[number], cv2.IMREAD_UNCHANGED) >= SURE
        depth = numpy.where(sure & (depth >= IPHONE_NEAREST), depth, 0)
        if (depth > 0).mean() < IPHONE_SHARE:
            continue
        colour = cv2.resize(colour, size, interpolation=cv2.INTER_AREA)
        depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)
        yield f"{number:06d}", colour, IPHONE, depth * UNIT


def kinect_classroom(folder):
    for number, colour, depth in pairs(folder, "mono/*.png", "depth/*.png"):
        if number in CLASSROOM_FRAMES:
            yield f"room_{number:06d}", colour, CLASSROOM, depth * UNIT


def tum_desk(folder):
    for number in (1, 2):
        depth = packs.read(folder / f"ch7/{number}_depth.png", cv2.IMREAD_UNCHANGED)
        colour = packs.read(folder / f"ch7/{number}.png")
        yield f"fr2desk_{number:06d}", colour, TUM_FREIBURG2, depth / TUM_STEPS * UNIT


def scannet_pair(folder):
    for number in SCANNET_FRAMES:
        colour = packs.read(folder / f"test_data/color/{number}.jpg")
        colour, of = packs.narrowed(colour, SCANNET, WIDTH)
        depth = packs.read(folder / f"test_data/depth/{number}.png", cv2.IMREAD_UNCHANGED)
        yield f"watercooler_{number:06d}", colour, of, registered(depth, SCANNET_DEPTH, of)


def replica_apartment0(folder):
    frames = (
        (floor[0], *frame)
        for floor in ("first_floor", "second_floor")
        for frame in pairs(folder / "Data_collection" / floor, "rgb/*.png", "depth/*.png")
    )
    for floor, number, colour, depth in itertools.islice(frames, 0, None, 2):
        depth = depth * APARTMENT_UNIT
        seen = depth > 0.1
        if seen.mean() >= APARTMENT_SHARE and numpy.median(depth[seen]) >= APARTMENT_NEAREST:
            yield f"{floor}{number:04d}", colour, APARTMENT, depth


def replica_office0(folder):
    frames = pairs(folder, "rgb/*.png", "depth/*.png")
    for number, colour, depth in itertools.islice(frames, 0, None, 3):
        colour, of = packs.narrowed(colour, OFFICE, WIDTH)
        size = (of["width"], of["height"])
        depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)
        yield f"{number:04d}", colour, of, depth * UNIT


def tables_left_out(clustering, posecnn):
    for folder, name, of in ((clustering, "uoc_{:04d}", UOC), (posecnn, "ycb_{:06d}", POSECNN)):
        demo = folder / "data/demo"
        for path in sorted(demo.glob("*-color.png")):
            depth = packs.read(demo / path.name.replace("color", "depth"), cv2.IMREAD_UNCHANGED)
            yield name.format(int(path.name[:6])), packs.read(path), of, depth * UNIT


PACKS = {
    realsense_floor: ["aims-slam"],
    xtion_chair: ["Minimisation-Tree-from-a-set-of-RGB-D-images"],
    xtion_mixed: ["IPV"],
    xtion_labs: ["TrackingMovingObjects_PIV"],
    iphone_desk: ["ImageRelocation"],
    kinect_classroom: [
        "Robot-Localization-using-Experience-Based-Localization-and-Visual-Odometry"
    ],
    tum_desk: ["slambook2"],
    scannet_pair: ["TemporallyConsistentDepth"],
    replica_apartment0: ["Semantic-Mapping-Framework"],
    replica_office0: ["CSCI5561_Project"],
    tables_left_out: ["UnseenObjectClustering", "PoseCNN-PyTorch"],
}


if __name__ == "__main__":
    packs.make(__doc__, PACKS, UNIT, QUALITY)
