#!/bin/sh
# The databases and the files of all runs into a new folder $1. Servers may run meanwhile: databases first, files after
# them, so no run in the backup misses a file. IN_POSTGRES and IN_STORE: how a command gets to where these live.
set -eu
to=$1
: "${IN_POSTGRES:=docker compose --project-name hfb exec -T postgres}"
: "${IN_STORE:=docker compose --project-name hfb exec -T store}"
umask 077
[ ! -e "$to" ] || { echo "backup: $to is there already; give a new folder" >&2; exit 2; }
mkdir -p "$to.part"
for database in prefect mlflow mlflow_auth; do
    $IN_POSTGRES pg_dump --username hfb --format custom "$database" > "$to.part/$database.dump"
done
# GNU tar ends with 1 where files change meanwhile; an archive that was cut off lacks the zeros at its end.
$IN_STORE tar -c -f - -C "${STORE_FOLDER:-/data}" . > "$to.part/store.tar" || [ $? -eq 1 ]
if [ ! -s "$to.part/store.tar" ] || [ -n "$(tail -c 1024 "$to.part/store.tar" | tr -d '\0')" ]; then
    echo "backup: the files of all runs could not be read to their end" >&2
    exit 1
fi
mv "$to.part" "$to"
