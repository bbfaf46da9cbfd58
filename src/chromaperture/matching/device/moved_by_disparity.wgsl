// For `channels_shifted.wgsl`: channels are displaced by disparity times direction.

fn sample(x: u32, y: u32, k: u32, disparity: f32) -> f32 {
    let direction = select(direction_of(k), vec2f(), abs(direction_of(k)) < vec2f(still));
    if (direction.y == 0.0) {
        // As `color/shift_kernels.py`: beyond 4 px outside there is only the border; 8 makes truncation round down.
        let place = clamp(f32(x) + disparity * direction.x, -4.0, f32(width + 4u)) + 8.0;
        let first = i32(place);
        return along_row(first - 8i, y, k, weights_at(place - f32(first)));
    }
    let moved = vec2f(f32(x), f32(y)) + disparity * direction;
    return cubic_at(moved, k);
}
