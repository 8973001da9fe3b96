#!/bin/sh
# Checks what pip cannot install: the shared libraries that open3d and pyrender (the extra `render`) load, and Python's venv module. On
# Debian and Ubuntu, it installs the missing packages if it may; elsewhere it lists them.
#
# With --tests, it installs the browser that some tests need. Without a browser these tests are skipped, so a failure
# here is no error.
set -eu

# shared library, Debian package
libraries="
libusb-1.0.so.0 libusb-1.0-0
libEGL.so.1     libegl1
libGL.so.1      libgl1
libX11.so.6     libx11-6
libudev.so.1    libudev1
libidn2.so.0    libidn2-0
libgomp.so.1    libgomp1
"

loads() { "$python" -c 'import ctypes, sys; ctypes.CDLL(sys.argv[1])' "$1" 2>/dev/null; }

# libEGL only dispatches: behind it there must be a driver, Mesa's (which needs no GPU) or NVIDIA's.
has_egl_driver() {
    loads libEGL_nvidia.so.0 && return
    for driver in /usr/lib/dri/*_dri.so /usr/lib64/dri/*_dri.so /usr/lib/*/dri/*_dri.so /usr/lib/*/libgallium-*.so; do
        if [ -e "$driver" ]; then return; fi
    done
    return 1
}

# Sets `things`, what is missing in words, and `packages`, the Debian packages that bring it.
look() {
    things= packages=
    while read -r library package; do
        if [ -n "$library" ] && ! loads "$library"; then miss "$library" "$package"; fi
    done <<EOF
$libraries
EOF
    has_egl_driver || miss "an EGL driver (Mesa)" libgl1-mesa-dri
    "$python" -c 'import ensurepip, venv' 2>/dev/null || miss "the venv module of $python" "$(venv_package)"
}

miss() {
    things="${things:+$things, }$1"
    packages="${packages:+$packages }$2"
}

venv_package() { "$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'; }

give_up() {
    echo "$*" >&2
    exit 1
}

# Sets `sudo`, which makes us root; fails if nothing does without a password.
may_install() {
    sudo=
    [ "$(id -u)" = 0 ] && return
    sudo="sudo -n"
    $sudo true 2>/dev/null
}

# shellcheck disable=SC2086  # one word a package
install() {
    $sudo apt-get -qq update || echo "system packages: the package lists could not be renewed, trying those at hand" >&2
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends $1 >/dev/null
}

has_browser() { command -v chromium && command -v chromedriver; } >/dev/null

prepare_tests() {
    if has_browser; then
        echo "system packages: a browser for the tests is there"
    elif command -v apt-get >/dev/null && may_install && echo "system packages: installing $browser for the tests" &&
        install "$browser" && has_browser; then
        echo "system packages: a browser for the tests is there now"
    else
        echo "system packages: the tests that need a browser will be skipped; on Debian they want: $browser"
    fi
}

browser="chromium chromium-driver"
if [ "${1:-}" = --tests ]; then
    prepare_tests
    exit
fi

if [ "$(uname -s)" != Linux ]; then
    echo "system packages: not checked, only Linux is"
    exit
fi
python=$("$(dirname "$0")/find-python.sh")
look
if [ -z "$things" ]; then
    echo "system packages: all there"
    exit
fi
command -v apt-get >/dev/null ||
    give_up "Missing on this system: $things. Install them with its package manager, then run this again."

may_install || give_up "Missing on this system: $things. Type: sudo apt-get update && sudo apt-get install -y $packages"
echo "system packages: installing $packages"
install "$packages" || give_up "apt-get could not install $packages: see its message above."
look
[ -z "$things" ] || give_up "Still missing after installing them: $things. Reinstall by hand: $packages."
