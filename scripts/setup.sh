#!/bin/sh
# Sets up .venv: finds a Python, creates the environment, installs the package and checks
# that gmsh can be imported. Called by make; may be run again at any time.
set -eu
cd "$(dirname "$0")/.."
venv=.venv

fail() {
    printf '\nset-up stopped: %s\n' "$1" >&2
    exit 1
}

new_enough() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

# A folder without pip is what Debian leaves behind where python3-venv was missing.
usable() {
    [ -x "$venv/bin/python" ] && new_enough "$venv/bin/python" &&
        "$venv/bin/python" -c 'import pip' >/dev/null 2>&1
}

find_python() {
    for candidate in ${PYTHON:-} python3 python3.14 python3.13 python3.12 python3.11; do
        if new_enough "$candidate"; then
            echo "$candidate"
            return
        fi
    done
}

create_environment() {
    python=$(find_python)
    [ -n "$python" ] || fail "Python 3.11 or newer is needed; found: $(python3 --version 2>&1 || true)
    Debian 12, Ubuntu 24.04 or newer:  sudo apt-get install python3 python3-venv
    elsewhere:                         make PYTHON=/path/to/python3.11"
    if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
        # Debian splits these off, and python -m venv would leave a broken folder behind.
        package="python$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv"
        if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
            apt-get update || true
            apt-get install -y "$package" || fail "apt-get could not install $package"
        else
            fail "this Python cannot create virtual environments. Install what it lacks:
    sudo apt-get update && sudo apt-get install -y $package"
        fi
    fi
    echo "creating $venv with $("$python" --version)"
    "$python" -m venv --clear "$venv" || fail "$python could not create $venv"
}

from_lock() {
    "$venv/bin/python" -m pip install -qq --disable-pip-version-check --require-hashes --only-binary :all: -r "$1"
}

# uv installs the locked versions in 18 s where pip takes 85 s. Where uv is not to be had, or does
# not get at the index that pip is set up with, pip does it and says what is wrong.
with_uv() {
    from_lock scripts/installer.lock 2>/dev/null &&
        UV_HTTP_TIMEOUT=30 "$venv/bin/uv" pip install -q --compile-bytecode --python "$venv/bin/python" \
            --require-hashes --only-binary :all: -r requirements.lock 2>/dev/null
}

# The versions of the lock file, each checked against its hash; they are those of one platform.
locked() {
    if [ "$("$venv/bin/python" -c 'import sys, platform; print(sys.platform, platform.machine(), "%d.%d" % sys.version_info[:2])')" != "linux x86_64 3.11" ]; then
        echo "no lock file for this Python or platform: taking the versions that pyproject.toml allows" >&2
        return 1
    fi
    with_uv || from_lock requirements.lock ||
        fail "the locked versions could not be installed, or a file is not the one that was locked; its reason
    stands above. Versions that pyproject.toml allows, without hashes:  NEWEST=1 sh scripts/setup.sh"
    # built by the setuptools of the lock: pip's isolation would fetch another one without a hash
    "$venv/bin/python" -m pip install -qq --disable-pip-version-check --no-deps --no-build-isolation --editable . ||
        fail "pip could not install the package itself; its reason stands above"
}

install_package() {
    extras=test
    case "$(uname -m)" in x86_64 | amd64) extras=fast,test ;; esac
    echo "installing study with its extras [$extras] into $venv (several hundred MB to download the first time)"
    if [ -z "${NEWEST:-}" ] && locked; then
        return
    fi
    if "$venv/bin/python" -m pip install -qq --disable-pip-version-check ${NEWEST:+--upgrade --upgrade-strategy eager} --editable ".[$extras]"; then
        return
    fi
    [ "$extras" != test ] || fail "pip could not install the package; its reason stands above"
    echo "trying again without the fast 3D solver (extra 'fast')" >&2
    "$venv/bin/python" -m pip install -qq --disable-pip-version-check --editable ".[test]" ||
        fail "pip could not install the package; its reason stands above"
}

usable || create_environment
install_package
# where PYTHONDONTWRITEBYTECODE is set every process would compile the package again
"$venv/bin/python" -m compileall -q study || fail "the package could not be compiled"
"$venv/bin/python" scripts/system_libraries.py || fail "gmsh does not work yet"
