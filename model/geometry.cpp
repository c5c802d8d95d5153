#include "model/geometry.h"

namespace lcdm::model {
namespace {

namespace F = torch::nn::functional;
using torch::indexing::Slice;

constexpr double kNearest = 1e-3;  // in front of the camera, when a point is projected

torch::Tensor along(const torch::Tensor& values, std::int64_t axis) {
  std::vector<std::int64_t> shape = {1, 1, 1, 1};
  shape[static_cast<std::size_t>(axis)] = values.numel();
  return values.reshape(shape);
}

torch::Tensor channel(const torch::Tensor& x, std::int64_t index) { return x.narrow(1, index, 1); }

// Window sums of `values` weighted by each of the kernels [n, size, size]: [B, n, H, W].
torch::Tensor window_sums(const torch::Tensor& values, const torch::Tensor& kernels, int dilation) {
  const std::int64_t reach = dilation * (kernels.size(1) / 2);
  return torch::conv2d(values, kernels.unsqueeze(1), {}, 1, reach, dilation);
}

}  // namespace

Pinholes pinholes_of(const std::vector<CameraModel>& cameras) {
  const auto n = static_cast<std::int64_t>(cameras.size());
  torch::Tensor values = torch::empty({4, n, 1, 1, 1});
  for (std::int64_t i = 0; i < n; ++i) {
    const CameraModel& camera = cameras[static_cast<std::size_t>(i)];
    values[0][i] = camera.fx;
    values[1][i] = camera.fy;
    values[2][i] = camera.cx;
    values[3][i] = camera.cy;
  }
  return {values[0], values[1], values[2], values[3]};
}

Rays rays_of(const Pinholes& cameras, std::int64_t height, std::int64_t width) {
  const torch::Tensor u = along(torch::arange(width, cameras.fx.options()), 3);
  const torch::Tensor v = along(torch::arange(height, cameras.fx.options()), 2);
  const std::vector<std::int64_t> shape = {cameras.fx.size(0), 1, height, width};
  return {((u - cameras.cx) / cameras.fx).expand(shape),
          ((v - cameras.cy) / cameras.fy).expand(shape)};
}

torch::Tensor back_project(const torch::Tensor& depth, const Pinholes& cameras) {
  const Rays rays = rays_of(cameras, depth.size(2), depth.size(3));
  return torch::cat({rays.x * depth, rays.y * depth, depth}, 1);
}

torch::Tensor rigid_motion(const torch::Tensor& axis_angle, const torch::Tensor& translation,
                           bool inverse) {
  const std::int64_t n = axis_angle.size(0);
  // sqrt has no gradient at 0, where a pose network starts.
  const torch::Tensor angle = (axis_angle.square().sum(1) + 1e-14).sqrt().reshape({n, 1, 1});
  const torch::Tensor axis = axis_angle / angle.reshape({n, 1});
  const torch::Tensor x = axis.select(1, 0), y = axis.select(1, 1), z = axis.select(1, 2);
  const torch::Tensor zero = torch::zeros_like(x);
  const torch::Tensor cross =
      torch::stack({zero, -z, y, z, zero, -x, -y, x, zero}, 1).reshape({n, 3, 3});
  torch::Tensor rotation = torch::eye(3, axis.options()) + torch::sin(angle) * cross +
                           (1 - torch::cos(angle)) * torch::matmul(cross, cross);
  torch::Tensor shift = translation.reshape({n, 3, 1});
  if (inverse) {
    rotation = rotation.transpose(1, 2);
    shift = -torch::matmul(rotation, shift);
  }
  const torch::Tensor last = torch::tensor({0.0F, 0.0F, 0.0F, 1.0F}, axis.options())
                                 .to(axis.dtype())
                                 .reshape({1, 1, 4})
                                 .expand({n, 1, 4});
  return torch::cat({torch::cat({rotation, shift}, 2), last}, 1);
}

torch::Tensor project(const torch::Tensor& points, const torch::Tensor& motion,
                      const Pinholes& cameras) {
  const torch::Tensor rotation = motion.index({Slice(), Slice(0, 3), Slice(0, 3)});
  const torch::Tensor shift = motion.index({Slice(), Slice(0, 3), Slice(3, 4)});
  const torch::Tensor moved =
      (torch::matmul(rotation, points.flatten(2)) + shift).reshape(points.sizes());
  const torch::Tensor z = channel(moved, 2).clamp_min(kNearest);
  return torch::cat({channel(moved, 0) / z * cameras.fx + cameras.cx,
                     channel(moved, 1) / z * cameras.fy + cameras.cy},
                    1);
}

torch::Tensor sample_at(const torch::Tensor& image, const torch::Tensor& pixels) {
  const auto last_column = static_cast<double>(image.size(3) - 1);
  const auto last_row = static_cast<double>(image.size(2) - 1);
  const torch::Tensor grid = torch::stack(
      {pixels.select(1, 0) * (2 / last_column) - 1, pixels.select(1, 1) * (2 / last_row) - 1}, 3);
  return F::grid_sample(image, grid,
                        F::GridSampleFuncOptions()
                            .mode(torch::kBilinear)
                            .padding_mode(torch::kBorder)
                            .align_corners(true));
}

// With P = Z (x0 + i/fx, y0 + j/fy, 1) for the window's pixel (i, j), n . P = 1 reads
// Z (i, j, 1) . m = 1 with m = (nx/fx, ny/fy, n . ray0): A m = b with
// A = sum Z^2 (i, j, 1)^T (i, j, 1) and b = sum Z (i, j, 1). Only m's direction is wanted, so the
// adjugate serves for the inverse: A is positive definite.
Normals surface_normals(const torch::Tensor& depth, const torch::Tensor& mask,
                        const Pinholes& cameras, int size, int dilation) {
  const int radius = size / 2;
  const auto options = depth.options().requires_grad(false);
  const torch::Tensor steps = torch::arange(-radius, radius + 1, options) / radius;
  const torch::Tensor ones = torch::ones({size, size}, options);
  const torch::Tensor i = steps.reshape({1, size}) * ones;
  const torch::Tensor j = steps.reshape({size, 1}) * ones;

  const torch::Tensor inside = torch::where(mask, depth, torch::zeros_like(depth));
  const torch::Tensor z = inside / depth.detach().abs().mean({1, 2, 3}, true);
  const torch::Tensor squares =
      window_sums(z.square(), torch::stack({i * i, i * j, i, j * j, j, ones}), dilation);
  const torch::Tensor sums = window_sums(z, torch::stack({i, j, ones}), dilation);
  const torch::Tensor count = window_sums(mask.to(z.dtype()), ones.unsqueeze(0), dilation);
  const torch::Tensor valid = count > size * size - 0.5;

  // Scaled by the window's own size, so that near and far windows are alike to fp32.
  const torch::Tensor scale = channel(squares, 5).clamp_min(1e-12);
  const torch::Tensor a = squares / scale;
  const torch::Tensor b = sums / scale.sqrt();
  const torch::Tensor a00 = channel(a, 0), a01 = channel(a, 1), a02 = channel(a, 2);
  const torch::Tensor a11 = channel(a, 3), a12 = channel(a, 4), a22 = channel(a, 5);
  const torch::Tensor b0 = channel(b, 0), b1 = channel(b, 1), b2 = channel(b, 2);
  const torch::Tensor c00 = a11 * a22 - a12 * a12, c01 = a02 * a12 - a01 * a22;
  const torch::Tensor c02 = a01 * a12 - a02 * a11, c11 = a00 * a22 - a02 * a02;
  const torch::Tensor c12 = a01 * a02 - a00 * a12, c22 = a00 * a11 - a01 * a01;
  const torch::Tensor m0 = c00 * b0 + c01 * b1 + c02 * b2;
  const torch::Tensor m1 = c01 * b0 + c11 * b1 + c12 * b2;
  const torch::Tensor m2 = c02 * b0 + c12 * b1 + c22 * b2;

  const Rays rays = rays_of(cameras, depth.size(2), depth.size(3));
  const double step = static_cast<double>(radius) * dilation;  // pixels of i = 1
  const torch::Tensor nx = m0 * cameras.fx / step;
  const torch::Tensor ny = m1 * cameras.fy / step;
  const torch::Tensor n = torch::cat({nx, ny, m2 - nx * rays.x - ny * rays.y}, 1);
  const torch::Tensor length = n.square().sum(1, true).clamp_min(1e-24).sqrt();
  return {-n / length, valid};
}

}  // namespace lcdm::model
