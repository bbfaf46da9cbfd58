// Distance by steps to the sides, along diagonals and as a knight's, as OpenCV's DIST_MASK_5 counts it (G. Borgefors 1986).

fn chamfer(dy: i32, dx: i32) -> f32 {
    let near = f32(min(abs(dy), abs(dx)));
    let far = f32(max(abs(dy), abs(dx)));
    if (2.0 * near <= far) { return far - 2.0 * near + 2.1969 * near; }
    return 2.1969 * (far - near) + 1.4 * (2.0 * near - far);
}
