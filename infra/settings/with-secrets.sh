#!/bin/sh
# For every variable NAME_FILE that names a file of secrets: NAME is what that file holds. Then what was to be run.
# So no secret is in a settings file, an image or a command line.
set -eu
secrets=${HFB_SECRETS:-/run/secrets}
for name in $(env | sed -n "s|^\([A-Z][A-Z0-9_]*\)_FILE=$secrets/.*|\1|p"); do
    eval "path=\${${name}_FILE}"
    [ -r "$path" ] || { echo "with-secrets: $path (for $name) cannot be read" >&2; exit 2; }
    value=$(cat "$path")
    export "$name=$value"
    unset "${name}_FILE"
done
exec "$@"
