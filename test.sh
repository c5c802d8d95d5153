#!/usr/bin/env bash
# Installs what is missing, builds everything and runs the tests.
#
#   ./test.sh          every test, the sanitizer subset and the format check
#   ./test.sh --all    the same, then the long ones: thread sanitizer, clang-tidy, g++-11
#
# Prints how long each stage took. Stops at the first stage that fails.
set -euo pipefail
cd "$(dirname "$0")"

all=false
case ${1:-} in
  '') ;;
  --all) all=true ;;
  -h | --help)
    sed -n '2,7s/^# \{0,1\}//p' "$0"
    exit 0
    ;;
  *)
    echo "test.sh: unknown option '$1': see ./test.sh --help" >&2
    exit 2
    ;;
esac

table=()
print_table() {
  printf '\n%-34s %8s\n' 'stage' 'minutes'
  printf '%s\n' "${table[@]}"
}
trap print_table EXIT

# stage NAME COMMAND...: runs the command and notes its time.
stage() {
  local name=$1 begin=$SECONDS
  shift
  printf '\n=== %s\n' "$name"
  "$@" || { printf '\n%s failed\n' "$name" >&2; exit 1; }
  table+=("$(printf '%-34s %8.1f' "$name" "$(bc_minutes $((SECONDS - begin)))")")
}
bc_minutes() { awk -v seconds="$1" 'BEGIN { print seconds / 60 }'; }

build() {
  cmake --preset "$1" >/dev/null && cmake --build --preset "$1" "${@:2}"
}
run_tests() {
  ctest --test-dir "build/$1" --output-on-failure --no-tests=error "${@:2}"
}
npm_packages() {
  (cd tests/browser && npm install --ignore-scripts --no-audit --no-fund --silent)
}
check_format() {
  git ls-files '*.h' '*.cpp' | xargs clang-format --dry-run --Werror
}

sanitizer_build() { build "$1" --target firmware_tests drivers_tests; }
sanitizer_tests() { run_tests "$1" -R "$sanitizer_subset"; }
sanitizer_subset='.*'

stage 'install' systemd/install-packages.sh run test train
stage 'npm packages' npm_packages
stage 'format' check_format
stage 'build' build trainer
stage 'tests' run_tests trainer
