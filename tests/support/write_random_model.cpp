// write_random_model ENCODER PRESET FILE: the random model that the golden fixtures were made of
// (README of tests/fixtures/golden).
#include <cstdio>
#include <string>

#include "tests/support/random_model.h"

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: write_random_model xxs|xs|s lcdm|paper FILE\n");
    return 2;
  }
  using lcdm::EncoderKind;
  const std::string encoder = argv[1];
  const EncoderKind kind = encoder == "xxs"  ? EncoderKind::kXxs
                           : encoder == "xs" ? EncoderKind::kXs
                                             : EncoderKind::kS;
  const auto preset =
      std::string(argv[2]) == "paper" ? lcdm::PresetKind::kPaper : lcdm::PresetKind::kLcdm;
  const auto image =
      lcdm::test::make_random_model(lcdm::test::make_config(kind, preset), lcdm::test::kGoldenSeed);
  std::FILE* file = std::fopen(argv[3], "wb");
  const bool written =
      file != nullptr && std::fwrite(image.data(), 1, image.size(), file) == image.size();
  return written && std::fclose(file) == 0 ? 0 : 1;
}
