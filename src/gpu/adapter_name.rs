//! The names of adapters.

/// The name of an adapter without the width of lavapipe's vectors: the width depends on settings, and the adapter is
/// the same.
pub fn without_width(name: &str) -> String {
    let is_width = |part: &str| part.strip_suffix(" bits").is_some_and(|bits| bits.parse::<u32>().is_ok());
    let last = name.strip_suffix(')').and_then(|open| open.rsplit_once(", "));
    match last {
        Some((rest, width)) if is_width(width) => format!("{rest})"),
        _ => name.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_width_is_taken_out_of_a_name() {
        for (name, expected) in [
            ("llvmpipe (LLVM 15.0.6, 256 bits)", "llvmpipe (LLVM 15.0.6)"),
            ("llvmpipe (LLVM 19.1.7, 512 bits)", "llvmpipe (LLVM 19.1.7)"),
            ("Some GPU (A, B)", "Some GPU (A, B)"),
            ("Some GPU (RADV NAVI31)", "Some GPU (RADV NAVI31)"),
            ("256 bits", "256 bits"),
            ("", ""),
        ] {
            assert_eq!(without_width(name), expected);
        }
    }
}
