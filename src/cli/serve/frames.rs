//! Messages on stdin and stdout. A message begins with its frame: the number of bytes of the header (u32), then of all
//! arrays (u64), both little-endian. The header follows, an object of JSON in UTF-8. Then come the arrays, one after
//! the other.

use serde_json::Value;
use std::io::{self, Read, Write};

/// Longest header that is read \[bytes\]: a scene file may have 256 MiB.
const MOST_HEADER_BYTES: u32 = 260 << 20;
/// Most bytes of arrays that are read: adjoints of large maps.
const MOST_ARRAY_BYTES: u64 = 1 << 32;

/// A message that was read.
#[derive(Debug, PartialEq)]
pub enum Incoming {
    /// Its header, and its arrays, one after the other.
    Header(Value, Vec<u8>),
    /// Its header is no JSON; what comes after it can be read.
    Broken(String),
}

/// Reads a message; `None` at the end of the stream.
///
/// # Errors
/// Where the frame itself makes no sense, so that the next one cannot be found.
pub fn read(input: &mut impl Read) -> io::Result<Option<Incoming>> {
    let mut frame = [0; 12];
    let mut filled = 0;
    while filled < frame.len() {
        match input.read(&mut frame[filled..]) {
            Ok(0) if filled == 0 => return Ok(None),
            Ok(0) => return Err(invalid("the stream ends within a frame")),
            Ok(count) => filled += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    let [a, b, c, d, arrays @ ..] = frame;
    let (header, arrays) = (u32::from_le_bytes([a, b, c, d]), u64::from_le_bytes(arrays));
    if header > MOST_HEADER_BYTES || arrays > MOST_ARRAY_BYTES {
        return Err(invalid(&format!(
            "a frame announces {header} bytes of header and {arrays} of arrays; at most {MOST_HEADER_BYTES} and \
             {MOST_ARRAY_BYTES} are read"
        )));
    }
    let header = exactly(input, u64::from(header))?;
    let arrays = exactly(input, arrays)?;
    Ok(Some(match serde_json::from_slice(&header) {
        Ok(value) => Incoming::Header(value, arrays),
        Err(error) => Incoming::Broken(format!("the header is no JSON: {error}")),
    }))
}

/// Writes a message.
///
/// # Errors
/// The errors of the stream.
pub fn write<'a>(
    output: &mut impl Write,
    header: &Value,
    arrays: impl Iterator<Item = &'a [u8]> + Clone,
) -> io::Result<()> {
    let header = header.to_string();
    let array_bytes: u64 = arrays.clone().map(|array| array.len() as u64).sum();
    output.write_all(&(header.len() as u32).to_le_bytes())?;
    output.write_all(&array_bytes.to_le_bytes())?;
    output.write_all(header.as_bytes())?;
    arrays.into_iter().try_for_each(|array| output.write_all(array))?;
    output.flush()
}

/// So many bytes. What a frame announces is not allocated before it has come.
fn exactly(input: &mut impl Read, count: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    input.take(count).read_to_end(&mut bytes)?;
    if (bytes.len() as u64) < count {
        return Err(invalid("the stream ends within a message"));
    }
    Ok(bytes)
}

fn invalid(problem: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, problem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_message_is_read_as_it_was_written() {
        let mut bytes = Vec::new();
        write(&mut bytes, &json!({"id": 1, "name": "ä"}), [&[1_u8, 2][..], &[3]].into_iter()).unwrap();
        write(&mut bytes, &json!({"id": 2}), std::iter::empty()).unwrap();
        let mut input = &bytes[..];
        assert_eq!(
            read(&mut input).unwrap(),
            Some(Incoming::Header(json!({"id": 1, "name": "ä"}), vec![1, 2, 3]))
        );
        assert_eq!(read(&mut input).unwrap(), Some(Incoming::Header(json!({"id": 2}), Vec::new())));
        assert_eq!(read(&mut input).unwrap(), None);
    }

    #[test]
    fn a_header_that_is_no_json_hides_no_later_message() {
        let mut bytes = 3_u32.to_le_bytes().to_vec();
        bytes.extend(0_u64.to_le_bytes());
        bytes.extend(b"{a}");
        write(&mut bytes, &json!({}), std::iter::empty()).unwrap();
        let mut input = &bytes[..];
        assert!(matches!(read(&mut input).unwrap(), Some(Incoming::Broken(_))));
        assert_eq!(read(&mut input).unwrap(), Some(Incoming::Header(json!({}), Vec::new())));
    }

    #[test]
    fn a_frame_that_is_cut_or_absurd_is_an_error() {
        for bytes in [&[1_u8, 2][..], &[255; 12], &[9, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, b'{']] {
            assert!(read(&mut &bytes[..]).is_err(), "{bytes:?}");
        }
    }
}
