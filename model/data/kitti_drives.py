#!/usr/bin/env python3
"""Makes more packs of KITTI's drives, from samples that lie in public repositories.

    git clone https://github.com/Deepak3994/Kitti-Dataset    # one, some or all of these
    python3 model/data/kitti_drives.py --checkouts . --output ../rooms

Pack, frames, repository at commit: its licence

    driving_kitti_2015         107  ziliHarvey/LiDAR-Guided-Boundary-Bleeding-Refinement-for-Depth-
                                    Map 51a4885: MIT by its README
    driving_kitti_drive5        31  Deepak3994/Kitti-Dataset c06969b: none stated
    driving_kitti_object_laser  12  AmrElsersy/PointPainting 8cc1271: none stated; calibrations from
                                    cajuntai/SFA3D-by-Maudzung 530a147
    driving_kitti_360           13  heisenberg141/Pointcloud-Segmentation 5b59556: none stated
    driving_kitti_odom_grey_3  115  viswans2132/visual_odometry 464aebc: none stated
    driving_kitti_pictures       7  ChenJiahao031008/SLAM-Demo d64fdf3: none stated
                                 6  tkwoo/StereoVisionforADAS bb99af3: GPL-2.0, its code
                                 4  asdtue2015/cardetector 58ab931: as OpenCV's
                                 2  kujason/ip_basic b6e6ce9: MIT

Wherever they lie, KITTI's and KITTI-360's frames are CC BY-NC-SA 3.0.

driving_kitti_2015 has KITTI's own disparities, with cars filled in; driving_kitti_odom_grey_3 and
driving_kitti_pictures have no depth; the others one sweep of the laser, as in public_drives.py.
11 of driving_kitti_object_laser's frames are in public_drives.py's driving_kitti_object too, there
without depth.
What shows places of test_kitti_object or kitti_left_out, or may (matched points), is left out.
Needs python3-opencv and python3-scipy.
"""
import cv2
import numpy

import packs
import public_drives as drives

# Of KITTI 2015: beside frames of test_kitti_object or kitti_left_out, or of the same street.
SHOWN_ELSEWHERE = {72, 84, 85, 86, *range(118, 133), *range(143, 147)}
DRIVE5_STEP = 5  # at 10 Hz
LASER_FRAMES = (4, 5, 6, 7, 9, 10, 11, 12, 13, 14, 15)
KITTI_360_STEP = 4
GREY_STEP, COLOUR_STEP, STREET_STEP = 7, 3, 4

# fx, cx, cy by the size of a rectified picture, which tells the day.
BY_SIZE = {
    (1242, 375): (721.5377, 609.5593, 172.854),
    (1241, 376): (718.856, 607.1928, 185.2157),
    (1238, 374): (718.3351, 600.3891, 181.5122),
    (1224, 370): (707.0493, 604.0814, 180.5066),
}


def driving_kitti_2015(folder):
    data = folder / "data"
    for path in sorted((data / "image_02").glob("*.png")):
        if int(path.stem) in SHOWN_ELSEWHERE:
            continue
        colour = packs.read(path)
        camera = drives.kitti_camera(colour, drives.SEPTEMBER_26)
        steps = packs.read(data / f"gt/disp_occ_0/{path.name}", cv2.IMREAD_UNCHANGED)
        yield path.stem, colour, camera, drives.depth_of_disparity(steps, camera)


def driving_kitti_drive5(folder):
    drive = folder / "KITTI_Cam_LIDAR_Projections/2011_09_26_drive_0005_sync"
    for path in sorted((drive / "image_02/data").glob("*.png"))[::DRIVE5_STEP]:
        sweep = drive / f"velodyne_points/data/{path.stem}.bin"
        yield drives.kitti_frame(f"d0005_{path.stem[-4:]}", path, sweep, drives.SEPTEMBER_26)


def driving_kitti_object_laser(painting, sfa3d):
    sample = painting / "Kitti_sample"
    many = painting / "tensorrt_inference/data"
    frames = [(many, f"{n:06d}", sfa3d / "training/calib") for n in LASER_FRAMES]
    for place, number, calibrations in [*frames, (sample, "000031", sample / "calib")]:
        yield drives.kitti_frame(
            f"train_{number}",
            place / f"image_2/{number}.png",
            place / f"velodyne/{number}.bin",
            drives.calibration(calibrations / f"{number}.txt"),
        )


def driving_kitti_360(folder):
    data = folder / "data"
    lines = drives.lines_of(data / "calibration/perspective.txt")
    rectified, seen = drives.matrix(lines["R_rect_00"]), drives.matrix(lines["P_rect_00"])
    numbers = (data / "calibration/calib_cam_to_velo.txt").read_text().split()
    to_camera = numpy.linalg.inv(numpy.vstack([drives.matrix(numbers), [0, 0, 0, 1]]))
    for path in sorted((data / "image_00/good_data").glob("*.png"))[::KITTI_360_STEP]:
        colour = packs.read(path)
        height, width = colour.shape[:2]
        camera = packs.camera(width, height, seen[0, 0], seen[1, 1], seen[0, 2], seen[1, 2])
        colour, camera = packs.narrowed(colour, camera, drives.WIDTH)
        sweep = drives.floats(data / f"velodyne_points/good_data/{path.stem}.bin", 4)
        points = drives.moved(sweep, to_camera) @ rectified.T
        yield f"k360_{path.stem[-5:]}", colour, camera, packs.nearest(points, camera)


def picture(name, path):
    """A frame without depth."""
    colour = packs.read(path)
    height, width = colour.shape[:2]
    focal, cx, cy = BY_SIZE[width, height]
    return name, colour, packs.camera(width, height, focal, focal, cx, cy), None


def driving_kitti_odom_grey_3(folder):
    for path in sorted((folder / "images").glob("*.png"))[::GREY_STEP]:
        yield picture(f"seq03_{path.stem}", path)


def driving_kitti_pictures(slam, streets, cars, basic):
    for path in sorted((slam / "data/image_2").glob("*.png"))[::COLOUR_STEP]:
        yield picture(f"seq01_{path.stem}", path)
    for path in sorted((streets / "data/left").glob("*.png"))[::STREET_STEP]:
        yield picture(f"adas_{path.stem}", path)
    for number in ("000024", "000026", "000027", "000030"):
        yield picture(f"train_{number}", cars / f"data/image_2/{number}.png")
    for number in ("000043", "006338"):
        yield picture(f"train_{number}", basic / f"images/{number}/{number}.png")


PACKS = {
    driving_kitti_2015: ["LiDAR-Guided-Boundary-Bleeding-Refinement-for-Depth-Map"],
    driving_kitti_drive5: ["Kitti-Dataset"],
    driving_kitti_object_laser: ["PointPainting", "SFA3D-by-Maudzung"],
    driving_kitti_360: ["Pointcloud-Segmentation"],
    driving_kitti_odom_grey_3: ["visual_odometry"],
    driving_kitti_pictures: ["SLAM-Demo", "StereoVisionforADAS", "cardetector", "ip_basic"],
}


if __name__ == "__main__":
    packs.make(__doc__, PACKS, drives.UNIT, drives.QUALITY)
