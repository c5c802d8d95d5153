// Geometry against planes, cameras and motions whose answers are known in closed form.
#include "model/geometry.h"

#include <cmath>
#include <gtest/gtest.h>

namespace lcdm::model {
namespace {

constexpr int kWidth = 160;
constexpr int kHeight = 96;

Pinholes camera(float focal) {
  return pinholes_of({{kWidth, kHeight, focal, focal * 0.9F, 70.5F, 51.25F, true}});
}

// The depth of the plane n . P = c in this camera, computed in double.
torch::Tensor plane_depth(const std::array<double, 3>& n, double c, const Pinholes& cameras) {
  const Rays rays = rays_of({cameras.fx.to(torch::kFloat64), cameras.fy.to(torch::kFloat64),
                             cameras.cx.to(torch::kFloat64), cameras.cy.to(torch::kFloat64)},
                            kHeight, kWidth);
  return (c / (n[0] * rays.x + n[1] * rays.y + n[2])).to(torch::kFloat32);
}

double degrees_between(const torch::Tensor& a, const torch::Tensor& b) {
  const torch::Tensor x = a.to(torch::kFloat64);
  const torch::Tensor y = b.to(torch::kFloat64);
  const double sine = torch::cross(x, y, 0).norm().item<double>();
  return std::atan2(sine, (x * y).sum().item<double>()) * 180 / M_PI;
}

TEST(BackProject, GivesThePinholeFormula) {
  const Pinholes cameras = camera(100);
  const torch::Tensor points = back_project(torch::full({1, 1, kHeight, kWidth}, 5.0F), cameras);
  EXPECT_NEAR(points[0][0][0][100].item<double>(), 5 * (100 - 70.5) / 100, 1e-5);
  EXPECT_NEAR(points[0][1][80][0].item<double>(), 5 * (80 - 51.25) / 90, 1e-5);
  EXPECT_NEAR(points[0][2][3][4].item<double>(), 5, 1e-6);
}

TEST(RigidMotion, TurnsAQuarterAboutZ) {
  const torch::Tensor motion =
      rigid_motion(torch::tensor({{0.0F, 0.0F, static_cast<float>(M_PI / 2)}}),
                   torch::tensor({{1.0F, 2.0F, 3.0F}}));
  const torch::Tensor moved =
      torch::matmul(motion[0], torch::tensor({1.0F, 0.0F, 0.0F, 1.0F}));  // x becomes y
  EXPECT_TRUE(torch::allclose(moved, torch::tensor({1.0F, 3.0F, 3.0F, 1.0F}), 0, 1e-6));
}

TEST(RigidMotion, InverseUndoesIt) {
  const torch::Tensor axis_angle = torch::tensor({{0.3F, -0.2F, 0.1F}});
  const torch::Tensor translation = torch::tensor({{0.5F, -1.0F, 2.0F}});
  const torch::Tensor both = torch::matmul(rigid_motion(axis_angle, translation),
                                           rigid_motion(axis_angle, translation, true));
  EXPECT_TRUE(torch::allclose(both[0], torch::eye(4), 0, 1e-6));
}

TEST(RigidMotion, HasAFiniteGradientWhereNothingMoves) {
  torch::Tensor axis_angle = torch::zeros({1, 3}, torch::requires_grad());
  rigid_motion(axis_angle, torch::zeros({1, 3})).sum().backward();
  EXPECT_TRUE(torch::isfinite(axis_angle.grad()).all().item<bool>());
}

TEST(Project, OfUnmovedPointsIsWhereTheyCameFrom) {
  const Pinholes cameras = camera(100);
  const torch::Tensor points = back_project(torch::rand({1, 1, kHeight, kWidth}) * 9 + 1, cameras);
  const torch::Tensor pixels =
      project(points, rigid_motion(torch::zeros({1, 3}), torch::zeros({1, 3})), cameras);
  EXPECT_NEAR(pixels[0][0][10][33].item<double>(), 33, 1e-3);
  EXPECT_NEAR(pixels[0][1][10][33].item<double>(), 10, 1e-3);
}

// A wall at 4 m, the camera moved .2 m to the right: the picture shifts by fx * .2 / 4 = 5 pixels.
TEST(SampleAt, SeesTheNeighbourWhereTheMotionSaysItIs) {
  const Pinholes cameras = camera(100);
  const torch::Tensor seen = torch::rand({1, 3, kHeight, kWidth});
  const torch::Tensor points = back_project(torch::full({1, 1, kHeight, kWidth}, 4.0F), cameras);
  const torch::Tensor motion =
      rigid_motion(torch::zeros({1, 3}), torch::tensor({{-0.2F, 0.0F, 0.0F}}));
  const torch::Tensor view = sample_at(seen, project(points, motion, cameras));
  EXPECT_TRUE(torch::allclose(view.narrow(3, 10, 100), seen.narrow(3, 5, 100), 0, 1e-3));
  // Beyond the border stands the border.
  EXPECT_TRUE(torch::allclose(view.narrow(3, 0, 1), seen.narrow(3, 0, 1), 0, 1e-3));
}

TEST(SurfaceNormals, OfSlantedPlanesAreExactInSinglePrecision) {
  const Pinholes cameras = camera(140);
  for (const std::array<double, 3>& tilt :
       {std::array<double, 3>{0, 0, 1}, {0.3, -0.4, 1}, {-0.1, 0.9, 1}}) {
    const torch::Tensor depth = plane_depth(tilt, 12, cameras);
    const torch::Tensor mask = torch::logical_and(depth > 0.5, depth < 60);
    for (const auto& [size, dilation] : {std::pair{5, 1}, std::pair{9, 4}}) {
      const Normals normals = surface_normals(depth, mask, cameras, size, dilation);
      const torch::Tensor n = torch::tensor({-tilt[0], -tilt[1], -tilt[2]}, torch::kFloat64);
      int seen = 0;
      for (int y = 0; y < kHeight; y += 7) {
        for (int x = 0; x < kWidth; x += 7) {
          if (!normals.valid[0][0][y][x].item<bool>()) continue;
          ++seen;
          ASSERT_LT(degrees_between(normals.direction[0].select(1, y).select(1, x), n), 0.05)
              << x << ", " << y << " window " << size;
        }
      }
      EXPECT_GT(seen, 20);
    }
  }
}

TEST(SurfaceNormals, AreInvalidAtTheBorderAndBesideHoles) {
  const Pinholes cameras = camera(140);
  torch::Tensor mask = torch::ones({1, 1, kHeight, kWidth}, torch::kBool);
  mask[0][0][40][60] = false;
  const Normals normals =
      surface_normals(torch::full({1, 1, kHeight, kWidth}, 3.0F), mask, cameras, 5, 1);
  EXPECT_FALSE(normals.valid[0][0][1][50].item<bool>());
  EXPECT_TRUE(normals.valid[0][0][2][50].item<bool>());
  EXPECT_FALSE(normals.valid[0][0][42][58].item<bool>());
  EXPECT_TRUE(normals.valid[0][0][43][60].item<bool>());
}

TEST(SurfaceNormals, HaveFiniteGradientsAlsoBesideHoles) {
  const Pinholes cameras = camera(140);
  torch::Tensor depth = (torch::rand({1, 1, kHeight, kWidth}) * 3 + 2).requires_grad_();
  const torch::Tensor mask = torch::rand({1, 1, kHeight, kWidth}) < 0.7;
  surface_normals(depth, mask, cameras, 5, 1).direction.square().sum().backward();
  EXPECT_TRUE(torch::isfinite(depth.grad()).all().item<bool>());
}

// Central differences of the third component, in double.
TEST(SurfaceNormals, GradientIsThatOfFiniteDifferences) {
  const CameraModel model{12, 10, 20, 20, 5.5F, 4.5F, true};
  Pinholes cameras = pinholes_of({model});
  cameras = {cameras.fx.to(torch::kFloat64), cameras.fy.to(torch::kFloat64),
             cameras.cx.to(torch::kFloat64), cameras.cy.to(torch::kFloat64)};
  torch::manual_seed(5);
  const torch::Tensor start = torch::rand({1, 1, 10, 12}, torch::kFloat64) + 2;
  const torch::Tensor mask = torch::ones({1, 1, 10, 12}, torch::kBool);
  const auto value = [&](const torch::Tensor& depth) {
    return surface_normals(depth, mask, cameras, 5, 1).direction[0][2][5][6];
  };
  torch::Tensor depth = start.clone().requires_grad_();
  value(depth).backward();
  constexpr double kStep = 1e-5;
  for (const int x : {4, 6, 8}) {
    torch::Tensor up = start.clone();
    torch::Tensor down = start.clone();
    up[0][0][5][x] += kStep;
    down[0][0][5][x] -= kStep;
    const double expected = (value(up) - value(down)).item<double>() / (2 * kStep);
    EXPECT_NEAR(depth.grad()[0][0][5][x].item<double>(), expected, 1e-6) << x;
  }
}

}  // namespace
}  // namespace lcdm::model
