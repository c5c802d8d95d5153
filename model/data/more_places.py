#!/usr/bin/env python3
"""Makes packs of tables, rendered places and single streets from samples in public repositories.

    git clone https://github.com/PointCloudLibrary/data    # one, some or all of these
    python3 model/data/more_places.py --checkouts . --output ../rooms

Pack, frames, repository at commit: licence

    kinect_tables_mosd  55  PointCloudLibrary/data 5c26bdd: BSD 3-clause; changed from the Object
                            Segmentation Database of TU Wien, which states none there
    tartanair_hospital  46  Inoriros/RGBD_map_stitching 3eeb3c9: none stated; TartanAir's own
    airsim_outdoors      2  huyaoyu/ImageFlow 1b8fb71: none stated
                         1  huyaoyu/Tutorial2020_Stereo d457c6d: BSD 3-clause; TartanAir's own
    cityscapes_demos     4  sakaridis/fog_simulation-SFSU_synthetic 8048e2e: not for commerce;
                            Cityscapes' own terms, research
    make3d_samples       6  kevinkarsch/depth-transfer 0351ffc: MSR-LA, not for commerce; Make3D's
                            own, research
    stereo_singles       2  louisfaul/computerVisionChallenge 7c45bb2: none stated; ETH3D's own
                         1  argoverse/argoverse-api f886ac5: MIT; Argoverse's own
                         1  scikit-image/scikit-image cd0a3d2: BSD 3-clause; Middlebury's own

The last three are of places where nothing else was taken: they validate. Pictures are at most 640
wide. Needs python3-opencv and python3-scipy.
"""
import json

import cv2
import numpy
import scipy.io

import packs

UNIT_NEAR, UNIT_FAR = 0.001, 1 / 256
QUALITY = 92
WIDTH = 640

TARTANAIR = packs.camera(640, 480, 320.0, 320.0, 320.0, 240.0)
FARTHEST = 60  # metres in packs of millimetres
TARTANAIR_STEP, TARTANAIR_NEAREST = 4, 0.5  # metres, median
TARTANAIR_BASELINE = 0.25  # metres
WOOD_FRAMES = ("000000_887749", "000030_894514")  # those between look like these
AIRSIM_FARTHEST = 200  # metres
KINECT_STEP = 2
ARGOVERSE_BASELINE = 0.2986
CITY_FARTHEST = 120  # metres: 4 pixels
CITY_BOTTOM = 800  # rows; below is the car's own bonnet
MAKE3D_FARTHEST = 79
MAKE3D_BAD = "op57-p-283t000"  # its left columns are not of the scene


def pfm(path):
    data = path.read_bytes()
    kind, size, scale, body = data.split(b"\n", 3)
    width, height = map(int, size.split())
    depth = numpy.frombuffer(body, "<f4" if float(scale) < 0 else ">f4", width * height)
    return numpy.flipud(depth.reshape(height, width)).astype(float)


def of_disparity(disparity, focal, baseline, shift=0.0):
    known = numpy.isfinite(disparity) & (disparity > 0)
    return numpy.where(known, focal * baseline / (numpy.where(known, disparity, 1) + shift), 0)


@packs.in_two_parts
def tartanair_hospital(folder):
    for path in sorted((folder / "image_left").glob("[0-9]*.png"))[::TARTANAIR_STEP]:
        depth = numpy.load(folder / f"depth_left/{path.stem}_depth.npy").astype(float)
        if numpy.median(depth) >= TARTANAIR_NEAREST:
            yield path.stem, packs.read(path), TARTANAIR, numpy.where(depth > FARTHEST, 0, depth)


def organised(path):
    """Picture, x, y, z of a packed PCD of label, x, y, z, rgba."""
    data = path.read_bytes()
    head, _, body = data.partition(b"\nDATA binary_compressed\n")
    fields = dict(line.split(b" ", 1) for line in head.splitlines() if b" " in line)
    if fields[b"FIELDS"] != b"label x y z rgba":
        raise SystemExit(f"{path}: not a cloud of label, x, y, z and rgba")
    width, height = int(fields[b"WIDTH"]), int(fields[b"HEIGHT"])
    packed, size = map(int, numpy.frombuffer(body, numpy.uint32, 2))
    plain = numpy.frombuffer(bytes(packs.lzf(body[8 : 8 + packed], size)), numpy.uint8)
    plain = plain.reshape(5, height, width, 4)
    x, y, z = (plain[of].copy().view(numpy.float32)[..., 0].astype(float) for of in (1, 2, 3))
    return plain[4][..., :3].copy(), x, y, z


@packs.in_two_parts
def kinect_tables_mosd(folder):
    files = sorted((folder / "segmentation/mOSD").glob("*/*.pcd"))
    for path in files[::KINECT_STEP]:
        colour, x, y, z = organised(path)
        known = numpy.isfinite(z) & (z > 0)
        row, column = numpy.nonzero(known)
        fx, cx = numpy.polyfit(x[known] / z[known], column, 1)
        fy, cy = numpy.polyfit(y[known] / z[known], row, 1)
        of = packs.camera(z.shape[1], z.shape[0], *(round(float(v), 2) for v in (fx, fy, cx, cy)))
        yield path.stem, colour, of, numpy.where(known, z, 0)


def middlebury_calibration(path):
    """Camera matrix, shift of the principal points (pixels), baseline (metres)."""
    lines = dict(line.split("=", 1) for line in path.read_text().splitlines() if "=" in line)
    matrix = numpy.array([row.split() for row in lines["cam0"].strip("[] \r").split(";")], float)
    return matrix, float(lines["doffs"]), float(lines["baseline"]) / 1000


def stereo_singles(eth3d, argoverse, skimage):
    for name in ("playground", "terrace"):
        place = eth3d / "images" / name
        matrix, shift, baseline = middlebury_calibration(place / "calib.txt")
        colour, disparity = packs.read(place / "im0.png"), pfm(place / "disp0.pfm")
        height, width = disparity.shape
        of = packs.camera(width, height, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
        depth = of_disparity(disparity, matrix[0, 0], baseline, shift)
        colour, of, depth = packs.fitted(colour, of, depth, WIDTH)
        yield f"eth3d_{name}", colour, of, depth
    data = argoverse / "tests/test_data/stereo"
    place = data / "rectified_stereo_images_v1.1/test/1"
    known = json.loads((place / "vehicle_calibration_stereo_info.json").read_text())
    known = {one["key"]: one["value"] for one in known["camera_data_"]}
    left = known["image_raw_stereo_front_left_rect"]
    colour = packs.read(place / "stereo_front_left_rect/stereo_front_left_rect_1.jpg")
    disparity = data / "disparity_maps_v1.1/test/1/stereo_front_left_rect_disparity/disparity_1.png"
    disparity = packs.read(disparity, cv2.IMREAD_UNCHANGED) / 256
    height, width = disparity.shape
    keys = ("focal_length_x_px_", "focal_length_y_px_", "focal_center_x_px_", "focal_center_y_px_")
    of = packs.camera(width, height, *(left[key] for key in keys))
    depth = of_disparity(disparity, of["fx"], ARGOVERSE_BASELINE)
    small_colour, small = packs.narrowed(colour, of, WIDTH)
    row, column = numpy.nonzero(depth)  # sparse: as points, or most would be lost
    z = depth[row, column]
    points = numpy.stack(
        [(column - of["cx"]) / of["fx"] * z, (row - of["cy"]) / of["fy"] * z, z], axis=1
    )
    yield "argoverse_1", small_colour, small, packs.nearest(points, small)
    place = skimage / "src/_skimage2/data"
    colour = packs.read(place / "motorcycle_left.png")
    with numpy.load(place / "motorcycle_disp.npz") as file:
        disparity = file["arr_0"].astype(float)
    height, width = disparity.shape
    of = packs.camera(width, height, 994.978, 994.978, 311.193, 254.877)
    depth = of_disparity(disparity, 994.978, 0.193001, 31.086)
    colour, of, depth = packs.fitted(colour, of, depth, WIDTH)
    yield "motorcycle", colour, of, depth


def cityscapes_demos(folder):
    """Cityscapes' own disparities (semi-global matching): 0 none, else (value - 1) / 256."""
    demos = folder / "data/demos"
    for path in sorted((demos / "leftImg8bit").glob("*.png")):
        name = path.name.replace("_leftImg8bit.png", "")
        known = json.loads((demos / f"camera/{name}_camera.json").read_text())
        lens = known["intrinsic"]
        colour = packs.read(path)
        steps = packs.read(demos / f"disparity/{name}_disparity.png", cv2.IMREAD_UNCHANGED)
        disparity = numpy.where(steps > 1, (steps.astype(float) - 1) / 256, 0)
        depth = of_disparity(disparity, lens["fx"], known["extrinsic"]["baseline"])
        depth = numpy.where(depth > CITY_FARTHEST, 0, depth)
        height, width = depth.shape
        of = packs.camera(width, height, lens["fx"], lens["fy"], lens["u0"], lens["v0"])
        of["height"] = CITY_BOTTOM
        colour, of, depth = packs.fitted(colour[:CITY_BOTTOM], of, depth[:CITY_BOTTOM], WIDTH)
        yield name, colour, of, depth


def make3d_samples(folder):
    """A laser's 55 x 305 ranges over the whole picture; its farthest, 80 m, is also the sky."""
    place = folder / "depth-transfer/examples/sample_training_data"
    width, height = 480, 640
    for path in sorted(place.glob("*.mat")):
        name = path.stem.replace("depth_sph_corr-", "")
        if name == MAKE3D_BAD:
            continue
        up, right, ahead, far = numpy.moveaxis(scipy.io.loadmat(str(path))["Position3DGrid"], -1, 0)
        colour = packs.read(place / f"img-{name}.jpg")
        colour = cv2.resize(colour, (width, height), interpolation=cv2.INTER_AREA)
        rows, columns = ahead.shape
        column = (numpy.arange(columns) + 0.5) * width / columns - 0.5
        row = (numpy.arange(rows) + 0.5) * height / rows - 0.5
        fx, cx = numpy.polyfit((right / ahead).mean(axis=0), column, 1)
        fy, cy = numpy.polyfit((-up / ahead).mean(axis=1), row, 1)
        of = packs.camera(width, height, *(round(float(v), 1) for v in (fx, fy, cx, cy)))
        depth = numpy.where(far < MAKE3D_FARTHEST, ahead, 0)
        depth = cv2.resize(depth, (width, height), interpolation=cv2.INTER_NEAREST)
        yield name, colour, of, depth


def airsim_outdoors(imageflow, tutorial):
    """Rendered: a wood, and TartanAir's old town."""
    sample = imageflow / "sample"
    known = json.loads((sample / "IFInput.json").read_text())["camera"]
    height, width = known["imageSize"]
    of = packs.camera(width, height, known["focal"], known["focal"], width / 2, height / 2)
    for name in WOOD_FRAMES:
        depth = numpy.load(sample / f"depth_plan/{name}_depth.npy").astype(float)
        depth = numpy.where(depth > AIRSIM_FARTHEST, 0, depth)
        yield f"wood_{name}", packs.read(sample / f"image/{name}_rgb.png"), of, depth
    place = tutorial / "SampleData/TartanAir/OldTown/EasyP000"
    disparity = numpy.load(place / "001116_left_disp.npy").astype(float)
    depth = of_disparity(disparity, TARTANAIR["fx"], TARTANAIR_BASELINE)
    depth = numpy.where(depth > AIRSIM_FARTHEST, 0, depth)
    yield "oldtown_001116", packs.read(place / "001116_left.png"), TARTANAIR, depth


NEAR = {tartanair_hospital: ["RGBD_map_stitching"], kinect_tables_mosd: ["data"]}
FAR = {
    airsim_outdoors: ["ImageFlow", "Tutorial2020_Stereo"],
    cityscapes_demos: ["fog_simulation-SFSU_synthetic"],
    make3d_samples: ["depth-transfer"],
    stereo_singles: ["computerVisionChallenge", "argoverse-api", "scikit-image"],
}


if __name__ == "__main__":
    packs.make(__doc__, NEAR, UNIT_NEAR, QUALITY)
    packs.make(__doc__, FAR, UNIT_FAR, QUALITY)
