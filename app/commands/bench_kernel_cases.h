// The kernels that `lcdm bench --kernels` measures, each at a layer's shape.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/nn/constant_store.h"
#include "firmware/nn/network.h"

namespace lcdm {

struct KernelCase {
  std::string name;
  Precision precision = Precision::kFloat32;
  double macs = 0;   // of the plain sums, whatever the algorithm
  double bytes = 0;  // of what is read and written, once each
  std::function<void()> run;
};

// The cases of the instruction set in use, which packs weights its own way; by name. All memory is
// `store`'s, which outlives them. kOutOfMemory.
Result<std::vector<KernelCase>> make_kernel_cases(ConstantStore& store);

}  // namespace lcdm
