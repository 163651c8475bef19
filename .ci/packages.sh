#!/bin/sh
# Install the system packages that tests need, where that can be done without a question; tests skip loudly where not.
set -u
command -v chromium >/dev/null 2>&1 && command -v chromedriver >/dev/null 2>&1 && exit 0
command -v apt-get >/dev/null 2>&1 || exit 0
as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi; }
echo "installing chromium and chromium-driver for the tests of the report"
install() { as_root apt-get install -y --no-install-recommends chromium chromium-driver fonts-dejavu-core; }
{ install || { as_root apt-get update && install; }; } >/dev/null 2>&1
exit 0
