//! The bytes of `catalog.bin`, whose layout stands in `python/tools/make_catalog.py`: integers, texts, lists of numbers, and
//! the optics of an entry. Every step returns `None` on data that does not follow it.

use crate::scene::materials::dispersion::{Dispersion, Table};

/// Whoever reads the embedded catalog may rely on this.
pub(super) const AS_WRITTEN: &str = "the embedded catalog is what its generator wrote";

/// Far above what the catalog inflates to, so that damaged data cannot ask for all memory \[bytes\].
const MAX_INFLATED: usize = 1 << 24;

/// The bytes of a catalog.
pub(super) fn inflate(compressed: &[u8]) -> Option<Vec<u8>> {
    miniz_oxide::inflate::decompress_to_vec_zlib_with_limit(compressed, MAX_INFLATED).ok()
}

/// The numbers of an entry.
#[derive(Debug)]
pub(super) struct Optics {
    pub(super) dispersion: Dispersion,
    pub(super) extinction: Option<Table>,
}

/// Unpacks the numbers of an entry.
pub(super) fn optics(bytes: &[u8]) -> Option<Optics> {
    let mut reader = Reader { bytes };
    let dispersion = match reader.unsigned()? {
        0 => Dispersion::Table(Table::new(reader.numbers()?.into(), reader.numbers()?)?),
        number @ 1..=9 => reader.formula(number as u8)?,
        _ => return None,
    };
    let extinction = reader.extinction(&dispersion)?;
    reader.bytes.is_empty().then_some(Optics { dispersion, extinction })
}

/// From this form on, each number has its own power of ten.
const OWN_EXPONENTS: u64 = 3;

/// What has not been read yet.
pub(super) struct Reader<'a> {
    pub(super) bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    pub(super) fn unsigned(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let (&byte, rest) = self.bytes.split_first()?;
            self.bytes = rest;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn signed(&mut self) -> Option<i64> {
        let value = self.unsigned()?;
        Some((value >> 1) as i64 ^ -((value & 1) as i64))
    }

    pub(super) fn index(&mut self) -> Option<usize> {
        usize::try_from(self.unsigned()?).ok()
    }

    pub(super) fn list<T>(&mut self, mut item: impl FnMut(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        (0..self.index()?).map(|_| item(self)).collect()
    }

    pub(super) fn text(&mut self) -> Option<String> {
        let length = self.index()?;
        let (text, rest) = self.bytes.split_at_checked(length)?;
        self.bytes = rest;
        String::from_utf8(text.to_vec()).ok()
    }

    /// The bytes of an entry's numbers, which are passed over: see [`optics`].
    pub(super) fn packed_optics(&mut self) -> Option<&'a [u8]> {
        let all = self.bytes;
        self.unsigned()?;
        self.pass_numbers()?;
        self.pass_numbers()?;
        // What kind of extinction it is says, too, how many lists it has.
        for _ in 0..self.unsigned()? {
            self.pass_numbers()?;
        }
        Some(&all[..all.len() - self.bytes.len()])
    }

    fn pass_numbers(&mut self) -> Option<()> {
        let count = self.index()?;
        if count == 0 {
            return Some(());
        }
        let exponents = if self.unsigned()? >= OWN_EXPONENTS { count } else { 1 };
        (0..exponents.checked_add(count)?).try_for_each(|_| self.unsigned().map(|_| ()))
    }

    fn formula(&mut self, number: u8) -> Option<Dispersion> {
        let range: [f64; 2] = self.numbers()?.try_into().ok()?;
        Some(Dispersion::Formula { number, coefficients: self.numbers()?, range: range.into() })
    }

    fn extinction(&mut self, dispersion: &Dispersion) -> Option<Option<Table>> {
        let wavelengths = match (self.unsigned()?, dispersion) {
            (0, _) => return Some(None),
            (1, Dispersion::Table(table)) => table.wavelengths().clone(),
            (2, _) => self.numbers()?.into(),
            _ => return None,
        };
        Table::new(wavelengths, self.numbers()?).map(Some)
    }

    fn numbers(&mut self) -> Option<Vec<f64>> {
        let count = self.index()?;
        if count == 0 {
            return Some(Vec::new());
        }
        let form = self.unsigned()?;
        let exponents = self.integers(if form >= OWN_EXPONENTS { count } else { 1 }, 1)?;
        let mantissas = self.integers(count, form % OWN_EXPONENTS)?;
        let exponents = exponents.iter().cycle();
        mantissas.iter().zip(exponents).map(|(&mantissa, &exponent)| decimal(mantissa, exponent)).collect()
    }

    /// Integers whose differences of the given order are stored.
    fn integers(&mut self, count: usize, order: u64) -> Option<Vec<i64>> {
        let mut values = (0..count).map(|_| self.signed()).collect::<Option<Vec<i64>>>()?;
        for _ in 0..order {
            let mut sum = 0i64;
            for value in &mut values {
                sum = sum.wrapping_add(*value);
                *value = sum;
            }
        }
        Some(values)
    }
}

/// Powers of ten that an f64 holds exactly.
const POWERS_OF_TEN: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];

/// The f64 nearest to `mantissa * 10^exponent`.
fn decimal(mantissa: i64, exponent: i64) -> Option<f64> {
    let power = POWERS_OF_TEN.get(usize::try_from(exponent.unsigned_abs()).ok()?);
    match power {
        // Both operands are exact, so the one rounding gives the nearest value, much faster than parsing does.
        Some(power) if mantissa.unsigned_abs() < 1 << f64::MANTISSA_DIGITS => {
            Some(if exponent < 0 { mantissa as f64 / power } else { mantissa as f64 * power })
        }
        _ => format!("{mantissa}e{exponent}").parse().ok(),
    }
}
