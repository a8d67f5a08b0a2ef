"""Tracking systems as trackers of a room. Each needs its own extra besides `zenoh`.

    python -m heliostat.track ros2 --topic /helmet/pose --room studio --connect tcp/127.0.0.1:17711
    python -m heliostat.track mqtt --broker 192.168.1.5 --layout dwm1001 --connect tcp/127.0.0.1:17711
    python -m heliostat.track qtm --host 192.168.1.6 --connect tcp/127.0.0.1:17711

| source | tracking system | extra |
| --- | --- | --- |
| `ros2` | topics with poses of ROS 2, published by `rmw_zenoh` | `ros2` |
| `mqtt` | tags that publish positions as JSON, such as UWB tags | `mqtt` |
| `qtm` | rigid bodies of Qualisys Track Manager | `qtm` |

- `heliostat.track.frame`: units, axes, rotation and origin of the system.
- `heliostat.track.users`: from measurements of bodies to reports of users; it has no thread and no clock.
- `heliostat.track.bridge`: runs a source as a tracker of a room. A system that is not listed implements `Source`.
"""
