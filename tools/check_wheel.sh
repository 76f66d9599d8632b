#!/usr/bin/env bash
# Builds the source distribution, a wheel from it without git, and runs the wheel in a fresh virtual environment where no
# compiler can be found.
# usage: tools/check_wheel.sh [PYTHON] [FOLDER]    (default: python3 build/wheel-check)
set -euo pipefail
python=$(command -v "${1:-python3}")
folder=${2:-build/wheel-check}
source=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
rm -rf "$folder"/{sdist,unpacked,wheel,builder,user,cache}

"$python" -m venv "$folder/builder"
pip() { "$folder/$1/bin/python" -m pip --quiet --disable-pip-version-check "${@:2}"; }
pip builder install build
cd "$folder"
"$folder/builder/bin/python" -m build --sdist --outdir sdist "$source" > sdist.log
mkdir unpacked
tar -xzf sdist/ctrplan-*.tar.gz -C unpacked
test ! -e unpacked/ctrplan-*/.git
pip builder wheel --no-deps --wheel-dir wheel unpacked/ctrplan-*

"$python" -m venv user
pip user install wheel/ctrplan-*.whl
# A folder with the few programs that are wanted instead of a path with a compiler on it.
mkdir -p user/tools
for program in sh bash cat uname; do ln -sf "$(command -v $program)" user/tools/; done
cd user
export PATH=$PWD/tools CTRPLAN_CACHE_DIR=$folder/cache
unset CC CXX PYTHONPATH
for compiler in cc c++ gcc g++ clang clang++; do
  if command -v $compiler; then echo "$compiler can still be found" >&2; exit 1; fi
done
scenarios=$(bin/python -c "import ctrplan, pathlib; print(pathlib.Path(ctrplan.__file__).parent / 'scenarios')")
bin/ctrplan --version
bin/ctrplan bound "$scenarios/robots/three_tube.toml" --theta-deg 0 90 180 --l-mm 0 -17 -62.8
bin/ctrplan plan "$scenarios/pair_free.toml" --time 2 -o out
bin/python -c "
import json
assert json.load(open('out/plan.json'))['certificate']['valid']
from ctrplan.mechanics.core import kernel_name
print('kernel:', kernel_name())"
echo "$(cd ../wheel && echo ctrplan-*.whl) runs without a compiler"
