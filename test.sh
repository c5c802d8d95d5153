#!/usr/bin/env bash
# Installs what is missing, builds everything and runs the tests.
#
#   ./test.sh          every test, the package, the booted guest and its soak, the sanitizer subset, the
#                      format
#   ./test.sh --all    the same, then the long ones: everything under the sanitizers, clang-tidy,
#                      g++-11, the kernels for Arm under QEMU (its libraries are 1 GB), everything of
#                      the guest, also of one for Arm (30 minutes and more), and longer soaks
#
# Prints how long each stage took. Stops at the first stage that fails.
set -euo pipefail
cd "$(dirname "$0")"

all=false
case ${1:-} in
  '') ;;
  --all) all=true ;;
  -h | --help)
    sed -n '2,11s/^# \{0,1\}//p' "$0"
    exit 0
    ;;
  *)
    echo "test.sh: unknown option '$1': see ./test.sh --help" >&2
    exit 2
    ;;
esac

table=()
print_table() {
  printf '\n%-34s %8s\n' 'stage' 'min:s'
  printf '%s\n' "${table[@]}"
}
trap print_table EXIT

# stage NAME COMMAND...: runs the command and notes its time.
stage() {
  local name=$1 begin=$SECONDS
  shift
  printf '\n=== %s\n' "$name"
  "$@" || { printf '\n%s failed\n' "$name" >&2; exit 1; }
  local seconds=$((SECONDS - begin))
  table+=("$(printf '%-34s %5d:%02d' "$name" $((seconds / 60)) $((seconds % 60)))")
}

build() {
  cmake --preset "$1" >/dev/null && cmake --build --preset "$1"
}
run_tests() {
  ctest --test-dir "build/$1" --parallel "$(nproc)" --output-on-failure --no-tests=error "${@:2}"
}
npm_packages() {
  local folder
  for folder in tests/peers tests/browser model/peers; do
    npm --prefix "$folder" install --no-package-lock --ignore-scripts --no-audit --no-fund --silent
  done
}
# Under sanitizers: the readers of untrusted bytes and the whole engine. Everything else of the tree
# is in `--all`.
sanitizer_subset=(wire_tests network_tests preprocess_tests engine_reference_tests)
run_soak() {
  LCDM_SOAK_SECONDS=$1 umockdev-wrapper build/trainer/bin/soak_tests --gtest_brief=1
}
# The kernels of an instruction set that `asan` leaves out.
avx512_programs=(kernel_tests engine_reference_tests precision_tests)
# build_programs PRESET PROGRAM..., run_programs alike.
build_programs() {
  cmake --preset "$1" >/dev/null && cmake --build --preset "$1" --target "${@:2}"
}
run_programs() {
  local program
  for program in "${@:2}"; do "build/$1/bin/$program" --gtest_brief=1 || return; done
}
# Of what is built already.
make_package() {
  package=$(./package.sh --preset trainer | tail -1) && echo "$package"
}
make_arm64_package() {
  arm64_package=$(./package.sh --preset arm64 | tail -1) && echo "$arm64_package"
}
check_format() {
  git ls-files '*.h' '*.cpp' | xargs clang-format --dry-run --Werror
}
# Not model/: LibTorch 1.13's headers do not compile as C++20 with Debian 12's clang.
# Nor files for libraries, or versions of them, that this machine lacks.
check_tidy() {
  local built="s|^ *\"file\": \"$PWD/\(.*\)\",\{0,1\}$|\1|p"
  comm -12 <(git ls-files 'firmware/*.cpp' 'drivers/*.cpp' 'app/*.cpp' | sort) \
    <(sed -n "$built" build/trainer/compile_commands.json | sort -u) |
    xargs -P "$(nproc)" -n 4 clang-tidy -p build/trainer --quiet --extra-arg=-Wno-unknown-warning-option
}
# The device part with the board's compiler (Ubuntu 22.04 has gcc 11).
build_board() {
  cmake --preset release -B build/gcc-11 -DCMAKE_CXX_COMPILER=g++-11 >/dev/null &&
    cmake --build build/gcc-11
}
# The same without what may be missing there.
build_bare() {
  cmake --preset release -B build/gcc-11-bare -DCMAKE_CXX_COMPILER=g++-11 -DLCDM_LIBCAMERA=OFF \
    -DLCDM_GPIO=OFF >/dev/null && cmake --build build/gcc-11-bare
}

# What depends on the processor, for 64-bit Arm under QEMU.
arm64_programs=(
  kernel_tests preprocess_tests precision_tests engine_reference_tests network_tests engine_tests
)
build_arm64() {
  cmake --preset arm64 >/dev/null && cmake --build --preset arm64 --target "${arm64_programs[@]}" lcdm
}
# `max` has fp16 and dot products of bytes: a guard of theirs that is skipped guards nothing.
run_arm64() {
  local program log=build/arm64/tests.log
  for program in "${arm64_programs[@]}"; do
    if ! qemu-aarch64-static -cpu max -L build/sysroot-arm64 "build/arm64/bin/$program" >"$log" 2>&1; then
      cat "$log"
      return 1
    fi
    tail -n 4 "$log"
    if grep 'SKIPPED.*\(fp16\|int8\)' "$log"; then return 1; fi
  done
}

stage 'install' systemd/install-packages.sh run package test train
stage 'npm packages' npm_packages
stage 'format' check_format
stage 'release build, with trainer' build trainer
stage 'tests' run_tests trainer
stage 'package' make_package
stage 'package test' tests/appliance/package_test.sh "$package"
stage 'booted guest' tests/appliance/run.sh --package "$package"
stage 'booted guest, soak' tests/appliance/soak.sh 2 --package "$package"
stage 'sanitizer subset, build' build_programs asan "${sanitizer_subset[@]}"
stage 'sanitizer subset, tests' run_programs asan "${sanitizer_subset[@]}"
if $all; then
  stage 'soak at real speed, long' run_soak 600
  stage 'address sanitizer build' build asan
  stage 'address sanitizer tests' run_tests asan -LE browser
  if grep -q avx512bw /proc/cpuinfo; then
    stage 'address sanitizer, AVX-512, build' build_programs asan-avx512 "${avx512_programs[@]}"
    stage 'address sanitizer, AVX-512, tests' run_programs asan-avx512 "${avx512_programs[@]}"
  else
    echo 'this processor has no AVX-512: its kernels are not run under the sanitizers'
  fi
  stage 'thread sanitizer build' build tsan
  stage 'thread sanitizer tests' run_tests tsan -LE browser
  stage 'clang-tidy' check_tidy
  stage 'g++-11 build' build_board
  stage 'g++-11 build, bare' build_bare
  stage 'arm64 libraries' tests/arm64/sysroot.sh
  stage 'arm64 build' build_arm64
  stage 'arm64 tests under QEMU' run_arm64
  stage 'arm64 package' make_arm64_package
  stage 'booted guest, arm64' tests/appliance/run.sh --all --arch arm64 --package "$arm64_package"
  stage 'booted guest, everything' tests/appliance/run.sh --all --package "$package"
  stage 'booted guest, long soak' tests/appliance/soak.sh 10 --package "$package"
fi
