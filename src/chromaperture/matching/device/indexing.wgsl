// The number of an invocation, and what lies beyond the borders of a picture.

// Of a dispatch whose workgroups of 64 are counted along x and y.
fn invocation(group: vec3u, groups: vec3u, local: u32) -> u32 {
    return (group.x + group.y * groups.x) * 64u + local;
}

// Mirrored at the border, whose pixel is not repeated (BORDER_REFLECT_101 of OpenCV). A loop and no remainder: that takes one division a lane.
fn mirrored(at: i32, count: u32) -> u32 {
    let last = i32(count) - 1i;
    if (last == 0i) { return 0u; }
    var place = abs(at);
    while (place > last) { place = abs(2i * last - place); }
    return u32(place);
}
