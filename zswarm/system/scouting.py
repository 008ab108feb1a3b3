"""Whether this machine can find others, and be found, by Zenoh's scouting over multicast."""

import socket
import struct

# Not zenoh's default group, on which every ROS 2 robot of the lab would join.
GROUP = "224.0.0.225:7467"


def fault() -> str:
    """Return why this machine cannot find or be found by multicast; "" if it can.

    Zenoh scouts on every interface except loopback that is up, has an IPv4 address and supports
    multicast. It needs no route.
    """
    try:
        found = interfaces()
    except OSError as error:
        # Such as netlink forbidden by systemd's RestrictAddressFamilies.
        return f"the network interfaces cannot be listed ({error.strerror})"
    group = socket.inet_aton(GROUP.partition(":")[0])
    why = "no network interface is up that has an IPv4 address and multicast"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for index, name in found:
            member = struct.pack("=4s4si", group, bytes(4), index)
            try:
                probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            except OSError as error:
                why = f"{name} cannot join the group {GROUP} ({error.strerror})"
            else:
                return ""
    return why


def interfaces() -> list[tuple[int, str]]:
    """Return number and name of the interfaces that Zenoh scouts on."""
    import psutil  # slows the start

    stats, addresses = psutil.net_if_stats(), psutil.net_if_addrs()
    return [
        (index, name)
        for index, name in socket.if_nameindex()
        if name in stats
        and {"up", "running", "multicast"} <= (flags := set(stats[name].flags.split(",")))
        and "loopback" not in flags
        and any(address.family == socket.AF_INET for address in addresses.get(name, ()))
    ]
