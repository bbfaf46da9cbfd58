// Labels of equal depth at a pixel of the halved picture: offset in its px, scale; `labels` has those of the full one.

fn half_label(x: u32, y: u32) -> vec2f {
    if (!labelled) { return vec2f(0.0, 1.0); }
    let at = 2u * y * full_width + 2u * x;
    return vec2f(labels[at] / 2.0, labels[full_width * full_height + at]);
}
