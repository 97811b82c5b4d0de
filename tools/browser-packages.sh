#!/bin/sh
# Bring Chromium and its driver, in which tests/judge/test_report.py opens the page that `semisynth-gl report` writes.
#
# Does nothing where both are here. Otherwise it installs Debian's packages if it may (as root, or with a sudo that asks
# for no password); if it may not, it says what to type. It never fails: without a browser those tests are skipped,
# unless SEMISYNTH_GL_EXPECT_BROWSER says that it must be there.
set -eu

packages="chromium chromium-driver"

say() {
    echo "$@" >&2
}

here() {
    command -v chromium >/dev/null && command -v chromedriver >/dev/null
}

if here; then
    exit 0
fi
# Ubuntu's package of Chromium installs a snap, which containers cannot run, and no package is called chromium-driver.
if ! command -v apt-get >/dev/null; then
    say "No chromium with chromedriver here: the tests that open the report in a browser are skipped."
    exit 0
fi
may=no
sudo=""
if [ "$(id -u)" -eq 0 ]; then
    may=yes
elif command -v sudo >/dev/null; then
    sudo="sudo "
    ! sudo -n true 2>/dev/null || may=yes
fi
if [ $may = no ]; then
    say "No chromium with chromedriver here: the tests that open the report in a browser are skipped. To have them:" \
        "${sudo}apt-get update && ${sudo}apt-get install -y $packages"
    exit 0
fi
${sudo}apt-get update -q ||
    say "apt-get update failed; going on with the package lists that are here."
if ! apt-cache show chromium-driver >/dev/null 2>&1; then
    say "This system offers no package chromium-driver: the tests that open the report in a browser are skipped."
    exit 0
fi
say "Installing $packages"
${sudo}env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $packages ||
    say "They cannot be installed: the tests that open the report in a browser are skipped."
