#!/bin/sh
# Install zswarm-ss on many machines, one after another: run the steps of docs/deploy.md by ssh.
#   fleet.sh install|upgrade|join|firewall|uninstall|status HOST...
# HOST is an ssh destination with root, or with sudo without a password. Stops at the first failure.
# install joins the keys of lab-01 from lab-01.zkeys in this folder; join updates them, and members.zkeys.
# PACKAGE: for pip, 'zswarm[keys] @ file:///PATH' of a wheel on the machines, or an address that
# ends in #sha256=HASH; a bare name is refused: an index may hold another's     KEYS=none: no keys
set -eu

install='
python3 -m venv /opt/zswarm
/opt/zswarm/bin/pip install --quiet "$PACKAGE"
cd /opt/zswarm/share/zswarm/systemd
install -D -m 644 zswarm.sysusers /etc/sysusers.d/zswarm.conf
install -D -m 644 zswarm.tmpfiles /etc/tmpfiles.d/zswarm.conf
install -D -m 644 zswarm-ss.service /etc/systemd/system/zswarm-ss.service
test -e /etc/zswarm/ss.toml || install -D -m 644 ss.toml /etc/zswarm/ss.toml
systemd-sysusers
[ ! "$keys" ] || /opt/zswarm/bin/zswarm-keys join --yes "$keys"
systemctl daemon-reload
systemctl enable --now zswarm-ss
'
# If pip fails, the old version serves again.
upgrade='
systemctl stop zswarm-ss
/opt/zswarm/bin/pip install --quiet --upgrade "$PACKAGE" || { systemctl start zswarm-ss; exit 1; }
cd /opt/zswarm/share/zswarm/systemd
install -D -m 644 zswarm-ss.service /etc/systemd/system/zswarm-ss.service
systemctl daemon-reload
systemctl start zswarm-ss
'
join='
[ ! "$keys" ] || /opt/zswarm/bin/zswarm-keys join --yes "$keys"
[ ! "$members" ] || /opt/zswarm/bin/zswarm-keys join "$members"
systemctl reload zswarm-ss
'
# What nftables loads when the machine starts is left as it is, but for a line.
firewall='
install -D -m 644 /opt/zswarm/share/zswarm/nftables/zswarm.nft /etc/zswarm/zswarm.nft
nft -f /etc/zswarm/zswarm.nft
grep -qs /etc/zswarm/zswarm.nft /etc/nftables.conf || echo "include \"/etc/zswarm/zswarm.nft\"" >> /etc/nftables.conf
systemctl enable nftables
'
uninstall='
systemctl disable --now zswarm-ss
rm -rf /opt/zswarm /etc/zswarm /var/lib/zswarm /var/cache/zswarm
[ ! -e /etc/nftables.conf ] || sed -i /zswarm.nft/d /etc/nftables.conf
rm -f /etc/systemd/system/zswarm-ss.service /etc/sysusers.d/zswarm.conf /etc/tmpfiles.d/zswarm.conf
systemctl daemon-reload
userdel zswarm
'
status='
systemctl is-active zswarm-ss || :
/opt/zswarm/bin/zswarm-ss --version || :
/opt/zswarm/bin/zswarm-ss status || :
'

usage="usage: fleet.sh install|upgrade|join|firewall|uninstall|status HOST..."
[ $# -ge 2 ] || { echo "$usage" >&2; exit 2; }
case $1 in
    install) script=$install ;;
    upgrade) script=$upgrade ;;
    join) script=$join ;;
    firewall) script=$firewall ;;
    uninstall) script=$uninstall ;;
    status) script=$status ;;
    *) echo "$usage" >&2; exit 2 ;;
esac
what=$1
shift

refuse() {
    echo "PACKAGE: expected 'zswarm[keys] @ file:///PATH' with a wheel's path on the machines, or" \
        "'zswarm[keys] @ https://ADDRESS#sha256=HASH', not '${PACKAGE:-}'" >&2
    exit 2
}
case $what in install | upgrade)
    case ${PACKAGE:-} in
        *"'"* | *'
'*) refuse ;;
        /* | *' @ file:///'*) ;;
        *' @ https://'*'#sha256='*)
            hash=${PACKAGE##*#sha256=}
            [ ${#hash} = 64 ] && [ -z "$(printf %s "$hash" | tr -d 0-9a-f)" ] || refuse
            ;;
        *) refuse ;;
    esac
esac

bring() {  # print commands that write file $2 on the host, and set variable $1 to its path
    if [ -r "$2" ]; then
        printf "%s=\$(mktemp)\nbase64 --decode > \"\$%s\" <<END\n%s\nEND\n" "$1" "$1" "$(base64 < "$2")"
    else
        echo "$1="
    fi
}

for host; do
    name=${host##*@}
    name=${name%%.*}
    files=
    case $what in install | join)
        files=$(bring keys "$name.zkeys"; bring members members.zkeys)
        wanted=$name.zkeys
        [ "$what" = install ] || [ ! -r members.zkeys ] || wanted=members.zkeys
        if [ "${KEYS:-}" = none ]; then
            files="keys="
        elif [ ! -r "$wanted" ]; then
            echo "$host: $wanted is not in this folder: see docs/keys.md, or set KEYS=none" >&2
            exit 1
        fi
    esac
    echo "$host: $what"
    # Keys travel on stdin, never as an argument, and ssh needs no terminal.
    printf "PACKAGE='%s'\n%s\n%s" "${PACKAGE:-}" "$files" "$script" |
        ssh "$host" 'if [ "$(id -u)" = 0 ]; then exec sh -eu; else exec sudo -n sh -eu; fi' ||
        { echo "$host: $what failed; the machines after it are unchanged" >&2; exit 1; }
done
