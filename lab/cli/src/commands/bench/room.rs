//! The room of the benchmarks that use no transport.

/// Overrides for a room with `users` users, some blocked by obstacles and bodies, and `side` x
/// `side` mirrors under a point LED.
pub fn overrides(users: usize, side: usize) -> Vec<String> {
    let mut set = vec![
        "led.side_m=0".into(),
        format!("users.count={users}"),
        format!("mirrors.rows={side}"),
        format!("mirrors.columns={side}"),
        "blockage.forced_users=0".into(),
        "blockage.bodies=true".into(),
        "blockage.obstacles_per_m2=0.08".into(),
    ];
    if side == 32 {
        // 1024 mirrors fit on the wall only when they are smaller.
        set.extend(["mirrors.width_m=0.1", "mirrors.height_m=0.04", "mirrors.gap_m=0.005"].map(String::from));
    }
    set
}
