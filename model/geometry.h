// Pinhole geometry on tensors: rays, rigid motion, views from elsewhere. Pixel centres lie on whole
// numbers; x to the right, y down, z forward; depth is Z.
#pragma once

#include <vector>

#include "firmware/vision/camera_model.h"
#include "model/torch.h"

namespace lcdm::model {

// The intrinsics of a batch of images, each [B, 1, 1, 1], pixels.
struct Pinholes {
  torch::Tensor fx, fy, cx, cy;
};
Pinholes pinholes_of(const std::vector<CameraModel>& cameras);

// (x, y) of Z = 1 at every pixel, each [B, 1, H, W].
struct Rays {
  torch::Tensor x, y;
};
Rays rays_of(const Pinholes& cameras, std::int64_t height, std::int64_t width);

// Equation 1: depth [B, 1, H, W] -> points [B, 3, H, W].
torch::Tensor back_project(const torch::Tensor& depth, const Pinholes& cameras);

// axis * angle [B, 3] and translation [B, 3] -> [B, 4, 4] that maps a point x to R x + t
// (Rodrigues). `inverse`: the motion undone.
torch::Tensor rigid_motion(const torch::Tensor& axis_angle, const torch::Tensor& translation,
                           bool inverse = false);

// Where the points [B, 3, H, W], moved by `motion` [B, 4, 4], fall in an image: [B, 2, H, W],
// pixels. Points behind the camera fall far outside.
torch::Tensor project(const torch::Tensor& points, const torch::Tensor& motion,
                      const Pinholes& cameras);

// `image` [B, C, H, W] looked up bilinearly at `pixels` [B, 2, H, W]; beyond its border, the
// border.
torch::Tensor sample_at(const torch::Tensor& image, const torch::Tensor& pixels);

struct Normals {
  torch::Tensor direction;  // [B, 3, H, W], unit length, towards the camera
  torch::Tensor valid;      // [B, 1, H, W] bool: the window lies in the image and in the mask
};
// Equations 2 and 3: of every pixel the plane n . P = 1 fitted by least squares to its window of
// `size` x `size` pixels, `dilation` apart. Solved in coordinates centred on the window, where fp32
// is exact to hundredths of a degree; the formula taken literally errs by whole degrees.
Normals surface_normals(const torch::Tensor& depth, const torch::Tensor& mask,
                        const Pinholes& cameras, int size, int dilation);

}  // namespace lcdm::model
