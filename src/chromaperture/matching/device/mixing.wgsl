// A pixel's light as the views and the guide see it; used by `views.wgsl` and `halve_rows.wgsl`. Where `whole`, views
// are in whole units of light, and their mean in an even number of them, so that halves are rounded as without it.

struct Pixel {
    views: vec3f,  // centred on the mean light of the usable pixels
    guide: f32,
    usable: f32,
}

fn pixel(x: u32, y: u32) -> Pixel {
    let at = 3u * (y * width + x);
    var rgb = vec3f(image[at], image[at + 1u], image[at + 2u]);
    let finite = is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z);
    let usable = finite && max(max(rgb.x, rgb.y), rgb.z) < saturation;
    if (!finite) { rgb = vec3f(stats[MEAN_ALL]); }
    let mean = vec3f(stats[MEAN_RED], stats[MEAN_RED + 1u], stats[MEAN_RED + 2u]);
    var views = vec3f();
    for (var k = 0u; k < view_count; k++) {
        let row = vec3f(rows[3u * k], rows[3u * k + 1u], rows[3u * k + 2u]);
        if (whole) {
            let even = 2.0 * round(0.5 * stats[UNIT + 1u] * dot(row, mean));
            views[k] = stats[UNIT] * (round(stats[UNIT + 1u] * dot(row, rgb)) - even);
        } else {
            views[k] = dot(row, rgb - mean);
        }
    }
    return Pixel(views, dot(vec3f(guide_rgb[0], guide_rgb[1], guide_rgb[2]), rgb), select(0.0, 1.0, usable));
}
