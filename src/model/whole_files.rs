//! Scenes, and files that a scene names: read whole, and at once or not at all.

use std::io::{Error, Read, Result};
use std::path::Path;

/// The contents of a file of at most `most` bytes; a longer one is not read. A pipe could keep a trace waiting for ever and a
/// device has no end, so that neither is opened.
pub(crate) fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    let found = std::fs::metadata(path)?;
    if found.is_dir() {
        return Err(Error::other("it is a folder, and no file"));
    }
    if !found.is_file() && !is_handed_over(path) {
        return Err(Error::other("it is a pipe or a device, and no file"));
    }
    let too_long = || Error::other(format!("the file is longer than {most} bytes"));
    if found.len() > most {
        return Err(too_long());
    }
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    // It may have grown meanwhile.
    if bytes.len() as u64 > most { Err(too_long()) } else { Ok(bytes) }
}

/// True of a stream that the caller of the program has opened: `nsq-gpu check <(command)`, `command | nsq-gpu check /dev/stdin`.
fn is_handed_over(path: &Path) -> bool {
    path == Path::new("/dev/stdin") || path.starts_with("/dev/fd") || path.starts_with("/proc/self/fd")
}

/// Text in any encoding that editors write. Beyond ASCII there are names and comments alone, so that what is neither UTF-8 nor
/// marked as UTF-16 is taken for Latin-1. Byte order marks are left out, wherever files were joined.
pub(crate) fn text(bytes: &[u8]) -> String {
    let words = |of: fn([u8; 2]) -> u16| {
        let units = bytes.chunks_exact(2).map(move |unit| of([unit[0], unit[1]]));
        char::decode_utf16(units).map(|unit| unit.unwrap_or(char::REPLACEMENT_CHARACTER))
    };
    let text: String = match bytes {
        [0xFF, 0xFE, ..] => words(u16::from_le_bytes).collect(),
        [0xFE, 0xFF, ..] => words(u16::from_be_bytes).collect(),
        _ => match std::str::from_utf8(bytes) {
            Ok(text) => text.to_owned(),
            Err(_) => bytes.iter().copied().map(char::from).collect(),
        },
    };
    if text.contains(MARK) { text.replace(MARK, "") } else { text }
}

/// A byte order mark.
pub(crate) const MARK: char = '\u{feff}';

#[cfg(test)]
mod tests {
    use crate::model::whole_files::text;

    #[test]
    fn encodings() {
        let written = "solid Körper\n";
        let utf_16: Vec<u16> = format!("\u{feff}{written}").encode_utf16().collect();
        let by = |of: fn(u16) -> [u8; 2]| -> Vec<u8> { utf_16.iter().copied().flat_map(of).collect() };
        let latin_1: Vec<u8> = written.chars().map(|c| u32::from(c) as u8).collect();
        let marked = format!("\u{feff}{written}");
        for bytes in
            [written.as_bytes(), marked.as_bytes(), &latin_1, &by(u16::to_le_bytes), &by(u16::to_be_bytes)]
        {
            assert_eq!(text(bytes), written, "{bytes:?}");
        }
        assert_eq!(text("v 0\n\u{feff}v 1\n".as_bytes()), "v 0\nv 1\n");
    }
}
