#!/usr/bin/env python3
"""Makes packs of drives, most with a laser's depth, from samples that lie in public repositories.

    git clone https://github.com/udacity/SFND_3D_Object_Tracking    # one, some or all of these
    python3 model/data/public_drives.py --checkouts . --output ../rooms

Pack, frames, repository at commit: its licence

    driving_kitti_object  22  cajuntai/SFA3D-by-Maudzung 530a147: none stated
                           3  Kazuki-Hara/kitti 4bf765a: none stated
    driving_kitti_jam     13  udacity/SFND_3D_Object_Tracking 3f28643: none stated
    driving_kitti_stereo   1  mli0603/stereo-transformer 44703b0: Apache-2.0
    driving_ddad          27  TRI-ML/dgp 1e06dc9: MIT
    driving_nuscenes       6  open-mmlab/mmdetection3d fe25f7a: Apache-2.0
    driving_pjlab          4  PJLab-ADG/SensorsCalibration 7fe8d46: Apache-2.0
    kitti_left_out         3  Kazuki-Hara/kitti 4bf765a: none stated
                           2  zhulf0804/PointPillars 620e6b0: MIT
                           1  azureology/kitti-velo2cam 2878c0e: MIT
                           1  balcilar/DenseDepthMap 3589873: Apache-2.0
                           1  open-mmlab/mmdetection3d fe25f7a: Apache-2.0; its calibration from
                              cajuntai/SFA3D-by-Maudzung 530a147
                           1  TA-Engineer/Perception_Robots_Depth_Maps 7ace00e: none stated

Wherever they lie, KITTI's frames are CC BY-NC-SA 3.0 and nuScenes' CC BY-NC-SA 4.0.

Depth is one sweep of the laser, turned into the camera, the nearest point of each pixel.
driving_kitti_stereo has KITTI's own disparities, driving_kitti_object no depth: the sweeps beside
its pictures are of others. KITTI's training frames 000000 to 000002 and 000023 are left out: our
test frames, test_kitti_object, are these or neighbours of these. Needs python3-opencv and
python3-scipy.
"""
import codecs
import json

import cv2
import numpy
from scipy.spatial.transform import Rotation

import packs

UNIT = 1 / 256
QUALITY = 93  # of JPEG: that of the pictures which METER's maps were made from
WIDTH = 1242  # KITTI's; what is larger is made as narrow

# What test_kitti_object tests with, or nearly, and what is in kitti_left_out.
SHOWN_BY_TEST = {"train_000000", "train_000001", "train_000002", "train_000023"}
LEFT_OUT = {"train_000003", "train_000008", "test_000002"}
NO_CALIBRATION = ("000462", "001426", "005541")  # their size is that of 26 September's pictures

# KITTI's car on 26 September 2011, as its calibration files have it.
SEPTEMBER_26 = {
    "P2": numpy.array(
        [
            [721.5377, 0, 609.5593, 44.85728],
            [0, 721.5377, 172.854, 0.2163791],
            [0, 0, 1, 0.002745884],
        ]
    ),
    "R0_rect": numpy.array(
        [
            [0.9999239, 0.00983776, -0.007445048],
            [-0.009869795, 0.9999421, -0.004278459],
            [0.007402527, 0.004351614, 0.9999631],
        ]
    ),
    "Tr_velo_to_cam": numpy.array(
        [
            [0.007533745, -0.9999714, -0.000616602, -0.004069766],
            [0.01480249, 0.0007280733, -0.9998902, -0.07631618],
            [0.9998621, 0.00752379, 0.01480755, -0.2717806],
        ]
    ),
}
BASELINE = (44.85728 + 339.5242) / 721.5377  # metres between its colour cameras, from P2 and P3
JAM_STEP = 6  # 78 frames of standing beside lorries look alike


def matrix(numbers, rows=3):
    return numpy.array(numbers, dtype=float).reshape(rows, -1)


def lines_of(path):
    """name: numbers, of a text file."""
    parts = (line.split(":", 1) for line in path.read_text().splitlines() if ":" in line)
    return {name.strip(): numbers.split() for name, numbers in parts}


def calibration(path):
    """Of KITTI's object set."""
    lines = lines_of(path)
    return {name: matrix(lines[name]) for name in ("P2", "R0_rect", "Tr_velo_to_cam")}


def raw_calibration(folder):
    """Of KITTI raw: calib_cam_to_cam.txt, calib_velo_to_cam.txt."""
    cameras = lines_of(folder / "calib_cam_to_cam.txt")
    laser = lines_of(folder / "calib_velo_to_cam.txt")
    return {
        "P2": matrix(cameras["P_rect_02"]),
        "R0_rect": matrix(cameras["R_rect_00"]),
        "Tr_velo_to_cam": numpy.hstack([matrix(laser["R"]), matrix(laser["T"])]),
    }


def kitti_camera(colour, of):
    height, width = colour.shape[:2]
    (fx, _, cx), (_, fy, cy), _ = of["P2"][:, :3].tolist()
    return packs.camera(width, height, fx, fy, cx, cy)


def moved(points, pose):
    return points @ pose[:3, :3].T + pose[:3, 3]


def floats(path, columns):
    return numpy.fromfile(path, numpy.float32).reshape(-1, columns)[:, :3].astype(float)


def kitti_frame(name, picture, sweep, of):
    colour = packs.read(picture)
    points = moved(floats(sweep, 4), of["Tr_velo_to_cam"]) @ of["R0_rect"].T
    points = points + numpy.linalg.solve(of["P2"][:, :3], of["P2"][:, 3])  # beside camera 0
    camera = kitti_camera(colour, of)
    return name, colour, camera, packs.nearest(points, camera)


def depth_of_disparity(steps, camera):
    """Of KITTI 2015's files: 1/256 pixels, 0 where there is none."""
    disparity = numpy.where(steps > 0, steps / 256, numpy.inf)
    return camera["fx"] * BASELINE / disparity


def driving_kitti_object(sfa3d, kitti):
    for split, folder in (("train", sfa3d / "training"), ("test", sfa3d / "testing")):
        for path in sorted((folder / "image_2").glob("*.png")):
            name = f"{split}_{path.stem}"
            if name not in SHOWN_BY_TEST | LEFT_OUT:
                colour = packs.read(path)
                of = calibration(folder / f"calib/{path.stem}.txt")
                yield name, colour, kitti_camera(colour, of), None
    for number in NO_CALIBRATION:
        colour = packs.read(kitti / f"image2/{number}.png")
        yield f"train_{number}", colour, kitti_camera(colour, SEPTEMBER_26), None


@packs.in_two_parts
def driving_kitti_jam(folder):
    day = folder / "images/KITTI/2011_09_26"
    for path in sorted((day / "image_02/data").glob("*.png"))[::JAM_STEP]:
        sweep = day / f"velodyne_points/data/{path.stem}.bin"
        yield kitti_frame(path.stem, path, sweep, SEPTEMBER_26)


def driving_kitti_stereo(folder):
    training = folder / "sample_data/KITTI_2015/training"
    colour = packs.read(training / "image_2/000046_10.png")
    camera = kitti_camera(colour, SEPTEMBER_26)
    steps = packs.read(training / "disp_occ_0/000046_10.png", cv2.IMREAD_UNCHANGED)
    yield "000046_10", colour, camera, depth_of_disparity(steps, camera)


def pose_of(json_pose):
    turn, shift = json_pose["rotation"], json_pose["translation"]
    pose = numpy.eye(4)
    pose[:3, :3] = Rotation.from_quat([turn["qx"], turn["qy"], turn["qz"], turn["qw"]]).as_matrix()
    pose[:3, 3] = [shift["x"], shift["y"], shift["z"]]
    return pose


def ddad_cameras(path):
    """Name -> fx, fy, cx, cy."""
    known = json.loads(path.read_text())
    keys = ("fx", "fy", "cx", "cy")
    values = ([one[key] for key in keys] for one in known["intrinsics"])
    return dict(zip(known["names"], values))


def driving_ddad(folder):
    for place in sorted((folder / "tests/data/dgp/test_scene").glob("scene_[0-9]*")):
        scene = json.loads(next(place.glob("scene_*.json")).read_text())
        data = {one["key"]: one for one in scene["data"]}
        for index, sample in enumerate(scene["samples"]):
            cameras = ddad_cameras(place / f"calibration/{sample['calibration_key']}.json")
            seen = {data[key]["id"]["name"]: data[key]["datum"] for key in sample["datum_keys"]}
            laser = seen.pop("LIDAR")["point_cloud"]
            with numpy.load(place / laser["filename"]) as sweep:
                world = moved(sweep["data"][:, :3], pose_of(laser["pose"]))
            for name, datum in sorted(seen.items()):
                image = datum["image"]
                camera = packs.camera(image["width"], image["height"], *cameras[name])
                colour = packs.read(place / image["filename"])
                colour, camera = packs.narrowed(colour, camera, WIDTH)
                points = moved(world, numpy.linalg.inv(pose_of(image["pose"])))  # a moment later
                yield f"{place.name}_{index}_{name}", colour, camera, packs.nearest(points, camera)


def driving_nuscenes(folder):
    place = folder / "demo/data/nuscenes"
    allowed = {
        ("numpy", "dtype"): numpy.dtype,
        ("numpy.core.multiarray", "scalar"): lambda kind, data: numpy.frombuffer(data, kind)[0],
        ("_codecs", "encode"): codecs.encode,
    }
    with next(place.glob("*.pkl")).open("rb") as file:
        frame = packs.Unpickler(file, allowed).load()["data_list"][0]
    sweep = floats(next(place.glob("*LIDAR_TOP*.bin")), 5)
    for name, image in frame["images"].items():
        colour = packs.read(place / image["img_path"])
        (fx, _, cx), (_, fy, cy), _ = image["cam2img"]
        camera = packs.camera(colour.shape[1], colour.shape[0], fx, fy, cx, cy)
        colour, camera = packs.narrowed(colour, camera, WIDTH)
        points = moved(sweep, numpy.array(image["lidar2cam"]))  # the car's own movement included
        yield name, colour, camera, packs.nearest(points, camera)


def pcd_points(path):
    """x, y, z of a PCD file, as text or packed, then field by field."""
    data = path.read_bytes()
    head, _, _ = data.partition(b"\nDATA ")
    kind, _, body = data[len(head) + len(b"\nDATA ") :].partition(b"\n")
    if kind == b"ascii":
        return numpy.array([line.split()[:3] for line in body.splitlines()], dtype=float)
    count = int(head.rsplit(b"POINTS ", 1)[1])
    packed, size = map(int, numpy.frombuffer(body, numpy.uint32, 2))
    plain = packs.lzf(body[8 : 8 + packed], size)
    return numpy.frombuffer(plain, numpy.float32, 3 * count).reshape(3, count).T.astype(float)


def pjlab_manual(folder):
    """Camera matrix, distortion, laser to camera."""
    lens = json.loads((folder / "center_camera-intrinsic.json").read_text())
    lens = lens["center_camera-intrinsic"]["param"]
    name = "top_center_lidar-to-center_camera-extrinsic"
    pose = json.loads((folder / f"{name}.json").read_text())[name]["param"]["sensor_calib"]
    distortion = matrix(lens["cam_dist"]["data"], 1)
    return matrix(lens["cam_K"]["data"]), distortion, matrix(pose["data"], 4)


def pjlab_automatic(folder):
    lines = lines_of(folder / "calib.txt")
    return matrix(lines["K"]), matrix(lines["D"], 1), matrix(lines["T"])


def driving_pjlab(folder):
    base = folder / "lidar2camera"
    manual = base / "manual_calib/data"
    frames = [("manual_0", manual / "0.png", manual / "0.pcd", pjlab_manual(manual))]
    for number in (1, 2, 3):
        place = base / f"auto_calib_v2.0/data/ours/{number}"
        picture = next(place.glob("calib.[jp][pn]g"))
        frames.append((f"ours_{number}", picture, place / "calib.pcd", pjlab_automatic(place)))
    for name, picture, sweep, (lens, distortion, pose) in frames:
        colour = cv2.undistort(packs.read(picture), lens, distortion)
        height, width = colour.shape[:2]
        (fx, _, cx), (_, fy, cy), _ = lens.tolist()
        camera = packs.camera(width, height, fx, fy, cx, cy)
        colour, camera = packs.narrowed(colour, camera, WIDTH)
        yield name, colour, camera, packs.nearest(moved(pcd_points(sweep), pose), camera)


def kitti_left_out(kitti, pillars, velo2cam, dense, mmdetection, sfa3d, robots):
    for number in ("000003", "002155", "007347"):
        yield kitti_frame(
            f"train_{number}",
            kitti / f"image2/{number}.png",
            kitti / f"velodyne/{number}.bin",
            calibration(kitti / f"calib/{number}.txt"),
        )
    for name, stem in (("test_000002", "test/000002"), ("train_000134", "val/000134")):
        base = pillars / "pointpillars/dataset/demo_data"
        yield kitti_frame(
            name,
            base / f"{stem}.png",
            base / f"{stem}.bin",
            calibration(base / f"{stem}.txt"),
        )
    yield kitti_frame(
        "test_000007",
        velo2cam / "data_object_image_2/testing/image_2/000007.png",
        velo2cam / "data_object_velodyne/testing/velodyne/000007.bin",
        calibration(velo2cam / "testing/calib/000007.txt"),
    )
    yield kitti_frame(
        "ddm_0000000001",
        dense / "data/image_2/0000000001.png",
        dense / "data/velodyne/0000000001.bin",
        calibration(dense / "data/calib/000001.txt"),
    )
    yield kitti_frame(
        "train_000008",
        mmdetection / "demo/data/kitti/000008.png",
        mmdetection / "demo/data/kitti/000008.bin",
        calibration(sfa3d / "training/calib/000008.txt"),
    )
    yield kitti_frame(
        "ta_000000",
        robots / "data/image/000000.png",
        robots / "data/velodyne/000000.bin",
        raw_calibration(robots / "data/calib"),
    )


PACKS = {
    driving_kitti_object: ["SFA3D-by-Maudzung", "kitti"],
    driving_kitti_jam: ["SFND_3D_Object_Tracking"],
    driving_kitti_stereo: ["stereo-transformer"],
    driving_ddad: ["dgp"],
    driving_nuscenes: ["mmdetection3d"],
    driving_pjlab: ["SensorsCalibration"],
    kitti_left_out: [
        "kitti",
        "PointPillars",
        "kitti-velo2cam",
        "DenseDepthMap",
        "mmdetection3d",
        "SFA3D-by-Maudzung",
        "Perception_Robots_Depth_Maps",
    ],
}


if __name__ == "__main__":
    packs.make(__doc__, PACKS, UNIT, QUALITY)
