#include "firmware/nn/kernels/isa.h"

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <string_view>

#include "firmware/nn/kernels/matrix.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/isa.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

const char* own_name() { return hwy::TargetName(HWY_TARGET); }

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(own_name);

namespace {

// Highway's names; the second for a set that the kernels are not compiled for by itself.
constexpr char kAvx512[] = "AVX3";
constexpr char kWithoutBfloat16[] = "AVX3_DL";

bool same_but_for_case(std::string_view a, std::string_view b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](unsigned char x, unsigned char y) {
    return std::tolower(x) == std::tolower(y);
  });
}

}  // namespace

const char* isa_name() { return HWY_DYNAMIC_DISPATCH(own_name)(); }

std::vector<std::string> isa_names() {
  std::vector<std::string> names;
  for (const auto target : hwy::SupportedAndGeneratedTargets()) {
    names.emplace_back(hwy::TargetName(target));
  }
  return names;
}

Status force_isa(const std::string& name) {
  hwy::SetSupportedTargetsForTest(0);  // those of the processor again
  hwy::GetChosenTarget().DeInit();     // chooses anew when the next kernel is called
  forgo_bfloat16(false);
  const bool forgo = same_but_for_case(name, kWithoutBfloat16);
  std::string known;
  for (const auto target : hwy::SupportedAndGeneratedTargets()) {
    const char* each = hwy::TargetName(target);
    const bool avx512 = same_but_for_case(each, kAvx512);
    if (same_but_for_case(each, name) || (forgo && avx512)) {
      hwy::SetSupportedTargetsForTest(target);
      forgo_bfloat16(forgo);
      return Status::ok();
    }
    known += (known.empty() ? "" : ", ") + std::string(each);
    if (avx512) known += std::string(", ") + kWithoutBfloat16;
  }
  return Status::error(StatusCode::kInvalidInput,
                       "LCDM_ISA=%.40s: no such instruction set here; there are %s", name.c_str(),
                       known.c_str());
}

Status force_isa_of_environment() {
  const char* name = std::getenv("LCDM_ISA");  // NOLINT(concurrency-mt-unsafe): no threads yet
  return name == nullptr || *name == '\0' ? Status::ok() : force_isa(name);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
