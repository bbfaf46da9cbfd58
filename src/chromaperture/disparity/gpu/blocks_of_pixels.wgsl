// The block of a pixel; what is left over at the right and below belongs to the last one.

fn block_at(y: u32, x: u32) -> u32 {
    return min(y / block, height / block - 1u) * (width / block) + min(x / block, width / block - 1u);
}
