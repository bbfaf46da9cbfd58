// Places in maps of `width` x `height` pixels, and what lies beyond their borders.

// Mirrored at the border, whose pixel is not repeated (OpenCV's BORDER_REFLECT_101).
fn reflected(at: i32, count: u32) -> u32 {
    let last = i32(count) - 1i;
    if (last <= 0i) { return 0u; }
    let place = abs(at) % (2i * last);
    return u32(min(place, 2i * last - place));
}

// Number of an invocation of a dispatch whose workgroups are counted along x and y.
fn invocation_of(group: vec3u, groups: vec3u, local: u32, size: u32) -> u32 {
    return (group.x + group.y * groups.x) * size + local;
}
