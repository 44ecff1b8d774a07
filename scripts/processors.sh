#!/usr/bin/env bash
# Run the numeric tests as other processors compute, by the switches that the libraries have for it, and without root's
# rights. Every switch runs, whatever fails; the last lines say which failed.
#
#     scripts/processors.sh PYTHON [SWITCH...]     # all switches by default
set -uo pipefail
cd "$(dirname "$0")/.."

python=${1:?the Python to test with}
shift
switches=("$@")
[ $# -gt 0 ] || switches=(aten-default aten-avx2 onednn-avx2 mkl-avx2 slow-products fast-products 1-thread 4-threads not-root)

# Everything but what computes next to nothing.
tests=(tests --ignore=tests/commands --ignore=tests/datasets --ignore=tests/shards --ignore=tests/config
       --ignore=tests/recipes --ignore=tests/test_readme.py --ignore=tests/test_download.py --ignore=tests/test_cli.py
       --ignore=tests/test_import.py --ignore=tests/test_house.py --ignore=tests/test_prose.py)

export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
run() { env "$@" "$python" -m pytest -n auto --maxprocesses 4 -p no:cacheprovider "${tests[@]}"; }

# All tests here, and not only the numeric ones: they write files. As user "nobody" where that user can start Python;
# a Python below root's home cannot be started by others, and then root keeps its name but none of its rights.
without_root() {
  if [ "$(id -u)" -ne 0 ]; then
    echo "You are not root: make test is this switch."
    return
  fi
  local drop=(setpriv --reuid=65534 --regid=65534 --clear-groups)
  if ! "${drop[@]}" env "$python" -c "import pytest, zoedepth" 2>/dev/null; then
    echo "User nobody cannot start $python: running as root with none of root's rights."
    drop=(setpriv --bounding-set=-all --inh-caps=-all)
  fi
  local home
  home=$(mktemp -d)
  chmod 777 "$home"
  "${drop[@]}" env HOME="$home" TMPDIR="$home" HYPOTHESIS_STORAGE_DIRECTORY="$home/hypothesis" \
    "$python" -m pytest -n auto --maxprocesses 4 -p no:cacheprovider
  local result=$?
  rm -rf "$home"
  return $result
}

failed=()
for switch in "${switches[@]}"; do
  echo "--- $switch"
  case $switch in
    aten-default) run ATEN_CPU_CAPABILITY=default ;;
    aten-avx2) run ATEN_CPU_CAPABILITY=avx2 ;;
    onednn-avx2) run ONEDNN_MAX_CPU_ISA=AVX2 ;;
    mkl-avx2) run MKL_ENABLE_INSTRUCTIONS=AVX2 ;;
    slow-products) run ZOEDEPTH_SLOW_PRODUCTS=1 ;;
    fast-products) run ZOEDEPTH_SLOW_PRODUCTS=0 ;;
    1-thread) run OMP_NUM_THREADS=1 ;;
    4-threads) run OMP_NUM_THREADS=4 ;;
    not-root) without_root ;;
    *) echo "there is no switch $switch" >&2; false ;;
  esac || failed+=("$switch")
done

if [ ${#failed[@]} -gt 0 ]; then
  echo "failed: ${failed[*]}"
  exit 1
fi
echo "passed: ${switches[*]}"
