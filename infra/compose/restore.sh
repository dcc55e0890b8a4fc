#!/bin/sh
# A backup of backup.sh back into the databases and the store; what is there now is replaced. Stop prefect, mlflow and
# the workers before: `docker compose --project-name hfb stop prefect mlflow worker`; restart the store after.
set -eu
from=$1
: "${IN_POSTGRES:=docker compose --project-name hfb exec -T postgres}"
: "${IN_STORE:=docker compose --project-name hfb exec -T store}"
for file in prefect.dump mlflow.dump mlflow_auth.dump store.tar; do
    [ -s "$from/$file" ] || { echo "restore: $from/$file is missing: is $from a backup?" >&2; exit 2; }
done
for database in prefect mlflow mlflow_auth; do
    $IN_POSTGRES dropdb --username hfb --if-exists --force "$database"
    $IN_POSTGRES createdb --username hfb "$database"
    $IN_POSTGRES pg_restore --username hfb --exit-on-error --dbname "$database" < "$from/$database.dump"
done
$IN_STORE tar -x -f - -C "${STORE_FOLDER:-/data}" < "$from/store.tar"
