#!/bin/sh
# The folders and secrets of `make up`, below $1, for the host $2; $3: the folder with clips. What is there stays as it is.
set -eu
state=$1 host=$2
[ -z "${3-}" ] || mkdir -p "$3"
umask 077
mkdir -p "$state/secrets" "$state/postgres" "$state/store" "$state/worker" "$state/redis"
cd "$state/secrets"
make() { [ -s "$1" ] || printf '%s' "$2" > "$1"; }
key() { openssl rand -hex 24; }
make postgres_password "$(key)"
make prefect_auth "hfb:$(key)"
make prefect_admin "admin:$(key)"
[ -z "${HFB_NOTIFY-}" ] || printf '%s' "$HFB_NOTIFY" > notify
[ -e notify ] || : > notify  # who is told of crashed runs: addresses as HFB_NOTIFY of infra/deploy.py
make mlflow_admin "$(key)"
make mlflow_worker "$(key)"
make mlflow_flask_key "$(key)"
make store_key "$(key)"
make s3.json "{\"identities\": [{\"name\": \"hfb\", \"actions\": [\"Admin\"],
  \"credentials\": [{\"accessKey\": \"hfb\", \"secretKey\": \"$(cat store_key)\"}]}]}"
redis=$(key)
[ -s redis_url ] || make redis.conf "$(printf 'bind 0.0.0.0\ndir /data\nappendonly yes\nmaxmemory-policy noeviction\nrequirepass %s' "$redis")"
make redis_url "redis://:$redis@redis:6379/0"
# The proxy tells members from the administrator by what a login looks like in a request; written anew each time.
as_sent() { base64 < "$1" | tr -d '\n'; }
as_pattern() { as_sent "$1" | sed 's/[+/=]/\\&/g'; }
cat > proxy_logins.part << END
map \$http_authorization \$hfb_member { default 0; "~^Basic $(as_pattern prefect_auth)\$" 1; }
map "\$http_authorization|\$http_hfb_administrator" \$hfb_administrator {
    default 0;
    "~^Basic $(as_pattern prefect_admin)\|" 1;
    "~\|$(as_pattern prefect_admin)\$" 1;
}
map \$http_authorization \$hfb_prefect_login {
    default \$http_authorization;
    "~^Basic $(as_pattern prefect_admin)\$" "Basic $(as_sent prefect_auth)";
}
END
mv proxy_logins.part proxy_logins
# Your own certificate for this host: put it here under the same names.
case $host in *[!0-9.]*) name=DNS:$host ;; *) name=IP:$host ;; esac
[ -s tls.crt ] || openssl req -x509 -newkey rsa:3072 -nodes -days 825 -keyout tls.key -out tls.crt -subj "/CN=$host" \
    -addext "subjectAltName=$name" 2> /dev/null
# Nothing runs as root, so that of root's files belongs to whom it runs as.
[ "$(id -u)" -ne 0 ] || chown -R "${HFB_UID:-1000}:${HFB_GID:-1000}" "$state" ${3+"$3"}
