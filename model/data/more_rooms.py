#!/usr/bin/env python3
"""Makes more packs of rooms with a depth camera's depth from samples in public repositories.

    git clone https://github.com/Robbyant/lingbot-depth    # one, some or all of these
    python3 model/data/more_rooms.py --checkouts . --output ../rooms

Pack, frames, repository at commit: licence

    xtion_lisbon     135  pedrovasco96/PIV_Project 05a648d, fsousa96/image_processing fedaba6,
                          gmestre98/3DImage-Reconstruction 13ecb27,
                          vascofaraujo/3D_PointCloud_Processing 4b96b54,
                          jonborg/PIV-Project 1f33472: none stated, all five
    tum_offices       34  jmstark/gpu_odometry aec7c85, fy2462/slam-learning d7d2346,
                          EdwardjkFeng/rgbd-vo d6f0859,
                          benchun123/cuboid_slam_with_bbox_constraints d228cfa: none stated;
                          TUM RGB-D's own CC BY 4.0
    lingbot_rooms      6  Robbyant/lingbot-depth 47764da: Apache 2.0
    rgbd_singles      15  mikiec84/Open3D 879b6fc: MIT (one of them SUN RGB-D's);
                          UFSEC/opencv_point_cloud_tutorial 3c31dba: MIT;
                          SpatialVision/Prior-Depth-Anything 8c029cb: Apache 2.0, its samples are
                          of ScanNet's, ETH3D's and such kinds, for research;
                          DepthAnything/PromptDA b05523c, TUI-NICR/EMSANet 9e739fd: Apache 2.0;
                          Sidlertime/3DSMC_BA 05818de: none stated, BundleFusion's own CC BY-NC-SA;
                          loveoxford/vReLoc 58ed183: none stated;
                          Clouds1997/3D_line 4021489: none stated, ICL-NUIM and TUM RGB-D CC BY

rgbd_singles are 13 places by several cameras, where nothing else was taken: they validate. Depth in
the files is millimetres as the picture's camera sees it (public_rooms.py turns it where another
camera saw it). Pictures are at most 640 wide. Needs python3-opencv and python3-scipy.
"""
import itertools

import cv2
import numpy

import packs
from public_rooms import HEIGHT, QUALITY, UNIT, WIDTH, XTION, from_xtion, moved, pairs

FARTHEST = 15.0  # metres

TUM_FREIBURG1 = packs.camera(WIDTH, HEIGHT, 517.3, 516.5, 318.6, 255.3)
TUM_FREIBURG3 = packs.camera(WIDTH, HEIGHT, 535.4, 539.2, 320.1, 247.6)
ICL = packs.camera(WIDTH, HEIGHT, 481.2, 480.0, 319.5, 239.5)
TUM_STEPS = 5  # a millimetre
TUM_MOVED = 20
CABINET = (0, 12, 24, 36, 48, 57)
TUM_LATEST = 0.02  # seconds between picture and depth

KINECT = packs.camera(WIDTH, HEIGHT, 532.189488, 532.189488, 318.839986, 244.149197)
KINECT_UNIT = 1e-4  # metres, as that repository's camera_info.txt has it
BUNDLEFUSION = packs.camera(WIDTH, HEIGHT, 583.0, 583.0, 320.0, 240.0)
PRIMESENSE = packs.camera(WIDTH, HEIGHT, 525.0, 525.0, 319.5, 239.5)

# Not stated there: what such a camera has.
D435 = packs.camera(WIDTH, HEIGHT, 610.0, 610.0, 320.0, 240.0)
IPHONE = packs.camera(1920, 1440, 1450.0, 1450.0, 960.0, 720.0)
AZURE = packs.camera(1440, 1080, 684.0, 684.0, 720.0, 540.0)
SCANNET = packs.camera(WIDTH, HEIGHT, 577.9, 580.2, 319.9, 239.9)  # made that size
BONN = packs.camera(WIDTH, HEIGHT, 542.8, 542.6, 315.6, 237.8)
SLR = packs.camera(WIDTH, HEIGHT, 360.0, 405.0, 320.0, 240.0)  # 3 : 2 pressed into 4 : 3


def in_millimetres(depth):
    """What the Xtion's .mat files have: some are in metres, some have NaN for none."""
    depth = numpy.nan_to_num(depth.astype(numpy.float64), nan=0.0, posinf=0.0, neginf=0.0)
    if depth.max() < 50:
        depth = depth / UNIT
    return numpy.round(numpy.clip(depth, 0, 9500)).astype(numpy.uint16)


def thinned(frames, least, most):
    """At most so many, none of which looks like the one before."""
    frames = list(moved(frames, least))
    step = max(1, -(-len(frames) // most))
    return itertools.islice(frames, 0, None, step)


def xtion_lisbon(vasco, sousa, mestre, faraujo, borg):
    """Hand-held and standing; what xtion_labs, xtion_mixed and xtion_chair have is left out."""
    for name, folder, colours, depths, least, most in (
        ("corridor_a", vasco / "corredor1", "rgb_image1_*.png", "depth1_*.mat", 8, 16),
        ("corridor_b", vasco / "corredor1", "rgb_image2_*.png", "depth2_*.mat", 8, 16),
        ("dining_a", vasco / "data_rgb", "rgb_image1_*.png", "depth1_*.mat", 4, 3),
        ("dining_b", vasco / "data_rgb", "rgb_image2_*.png", "depth2_*.mat", 4, 3),
        ("dining_c", sousa / "maizena2", "rgb_image1_*.png", "depth1_*.mat", 4, 2),
        ("dining_d", sousa / "maizena2", "rgb_image2_*.png", "depth2_*.mat", 4, 2),
        ("chairs_a", vasco / "duascamaras", "rgb_image1_*.png", "depth1_*.mat", 4, 4),
        ("chairs_b", vasco / "duascamaras", "rgb_image2_*.png", "depth2_*.mat", 4, 4),
        ("lab2_a", vasco / "lab2", "rgb_image1_*.png", "depth1_*.mat", 6, 6),
        ("lab2_b", vasco / "lab2", "rgb_image2_*.png", "depth2_*.mat", 6, 6),
        ("crowd", vasco / "confusao", "images*.jpg", "images*.mat", 6, 6),
        ("laptop", sousa / "fruta1", "rgb_image1_*.png", "depth1_*.mat", 4, 6),
        ("poster", mestre / "malandreco", "rgb_image_*.png", "depth_*.mat", 8, 12),
        ("office", mestre / "office", "rgb_*.jpg", "depth_*.mat", 8, 5),
        ("desk", mestre / "officenmotion", "rgb_*.jpg", "depth_*.mat", 10, 8),
        ("desk_moved", mestre / "officewmotion", "rgb_*.jpg", "depth_*.mat", 10, 6),
        ("room", mestre / "room1", "rgb_*.jpg", "depth_*.mat", 8, 7),
        ("table", mestre / "table", "rgb_*.jpg", "depth_*.mat", 8, 8),
        ("board_a", mestre / "board1", "rgb_*.jpg", "depth_*.mat", 10, 3),
        ("board_b", mestre / "board2", "rgb_*.jpg", "depth_*.mat", 10, 3),
        ("carpet", faraujo / "hobbes_moving", "rgb_*.jpg", "depth_*.png", 8, 6),
        ("lobby_a", borg / "newpiv1", "rgb_image_*.png", "depth_*.mat", 8, 5),
        ("lobby_b", borg / "newpiv3", "rgb_image_*.png", "depth_*.mat", 8, 3),
        ("lobby_c", borg / "newpiv4", "rgb_image_*.png", "depth_*.mat", 8, 4),
    ):
        found = pairs(folder, colours, depths)
        for number, colour, depth in thinned(found, least, most):
            yield f"{name}_{number:04d}", colour, XTION, from_xtion(in_millimetres(depth))


def nearest_in_time(rgb, depths):
    times = {float(path.stem): path for path in depths.glob("*.png")}
    for path in sorted(rgb.glob("*.png")):
        time = min(times, key=lambda one: abs(one - float(path.stem)))
        if abs(time - float(path.stem)) <= TUM_LATEST:
            yield path, times[time]


def tum_offices(turning, desk, plant, cabinet):
    for name, rgb, depths, most in (
        ("rpy", turning / "data/rgb", turning / "data/depth", 24),
        ("desk", desk / "data/rgb", desk / "data/depth", 2),
        ("plant", plant / "data_examples/TUM/color", plant / "data_examples/TUM/depth", 2),
    ):
        found = (
            (number, packs.read(colour), packs.read(depth, cv2.IMREAD_UNCHANGED))
            for number, (colour, depth) in enumerate(nearest_in_time(rgb, depths))
        )
        least = TUM_MOVED if name == "rpy" else 3
        for number, colour, depth in thinned(found, least, most):
            yield f"{name}_{number:06d}", colour, TUM_FREIBURG1, depth / TUM_STEPS * UNIT
    for number in CABINET:
        stem = f"{number:04d}"
        colour = packs.read(cabinet / f"data/raw_imgs/{stem}_rgb_raw.jpg")
        depth = packs.read(cabinet / f"data/depth_imgs/{stem}_depth_raw.png", cv2.IMREAD_UNCHANGED)
        yield f"cabinet_{number:06d}", colour, TUM_FREIBURG3, depth / TUM_STEPS * UNIT


def lingbot_rooms(folder):
    for number in (0, 1, 2, 4, 5, 6):  # 3 is outdoors, 7 an aquarium
        place = folder / "examples" / str(number)
        matrix = numpy.loadtxt(place / "intrinsics.txt")
        of = packs.camera(
            WIDTH, HEIGHT, *(float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        )
        depth = packs.read(place / "raw_depth.png", cv2.IMREAD_UNCHANGED)
        depth = numpy.where(depth > 10000, 0, depth)
        yield f"room_{number}", packs.read(next(place.glob("rgb.*"))), of, depth * UNIT


def of_sun(steps):
    """SUN RGB-D keeps millimetres turned left by three bits."""
    return (steps >> 3) | (steps << 13)


def in_bgr(path):
    if path.suffix == ".npy":
        return cv2.cvtColor(numpy.load(path), cv2.COLOR_RGB2BGR)
    return packs.read(path)


def steps_of(path):
    if path.suffix == ".npy":
        return numpy.load(path).astype(numpy.float64)
    return packs.read(path, cv2.IMREAD_UNCHANGED)


def rgbd_singles(open3d, clouds, prior, arkit, azure, bundle, robot, lines):
    kinect, samples = clouds / "images", open3d / "examples/TestData/RGBD"
    sun = samples / "other_formats"
    for name, folder, colour, depth, of, unit in (
        ("open3d_chair", samples, "color/00000.jpg", "depth/00000.png", PRIMESENSE, UNIT),
        ("sun_corridor", sun, "SUN_color.jpg", "SUN_depth.png", PRIMESENSE, UNIT),
        ("sofa_1", kinect, "color.png", "depth.png", KINECT, KINECT_UNIT),
        ("sofa_2", kinect, "color_2.png", "depth_2.png", KINECT, KINECT_UNIT),
        ("arena_1", kinect, "color_arena_1.png", "depth_arena_1.png", KINECT, KINECT_UNIT),
        ("arena_2", kinect, "color_arena_2.png", "depth_arena_2.png", KINECT, KINECT_UNIT),
        ("scannet_hotel", prior, "sample-1/rgb.jpg", "sample-1/gt_depth.png", SCANNET, UNIT),
        ("walker", prior, "sample-5/rgb.npy", "sample-5/gt_depth.npy", BONN, UNIT),
        ("eth_corridor", prior, "sample-6/rgb.npy", "sample-6/gt_depth.npy", SLR, 1),
        ("shelves", arkit, "image.jpg", "arkit_depth.png", IPHONE, UNIT),
        ("lounge", azure / "samples", "sample_rgb.png", "sample_depth.png", AZURE, UNIT),
        ("stairs", bundle, "frame-000000.color.jpg", "frame-000000.depth.png", BUNDLEFUSION, UNIT),
        ("vicon", robot, "frame-000000.color.png", "frame-000000.depth.png", D435, UNIT),
        ("icl_sofa", lines, "color/0.png", "depth/0.png", ICL, UNIT / TUM_STEPS),
        ("tum_sitting", lines, "color/1.png", "depth/1.png", TUM_FREIBURG3, UNIT / TUM_STEPS),
    ):
        picture, steps = in_bgr(folder / colour), steps_of(folder / depth)
        metres = (of_sun(steps) if folder == sun else steps) * unit
        metres = numpy.where(metres > FARTHEST, 0, metres)
        yield name, *packs.fitted(picture, of, metres, WIDTH)


PACKS = {
    xtion_lisbon: [
        "PIV_Project",
        "image_processing",
        "3DImage-Reconstruction",
        "3D_PointCloud_Processing",
        "PIV-Project",
    ],
    tum_offices: [
        "gpu_odometry",
        "slam-learning",
        "rgbd-vo",
        "cuboid_slam_with_bbox_constraints",
    ],
    lingbot_rooms: ["lingbot-depth"],
    rgbd_singles: [
        "Open3D",
        "opencv_point_cloud_tutorial",
        "Prior-Depth-Anything/assets",
        "PromptDA/assets/example_images",
        "EMSANet",
        "3DSMC_BA",
        "vReLoc",
        "3D_line",
    ],
}


if __name__ == "__main__":
    packs.make(__doc__, PACKS, UNIT, QUALITY)
