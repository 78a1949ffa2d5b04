//! Decimal numbers from bytes, correctly rounded, most of them without a call to the standard parser.

/// Powers of ten that a double holds exactly.
const EXACT_POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];

/// Returns the number that `token` spells, rounded as `str::parse` rounds, or `None` if it spells none.
///
/// `nan` and `inf` are numbers here; callers that need finite ones check.
#[inline]
pub(crate) fn parse_number(token: &[u8]) -> Option<f64> {
    match leading_number(token) {
        Some((value, length)) if length == token.len() => Some(value),
        _ => parse_slowly(token),
    }
}

/// Returns the number at the start of `bytes` and its length, where that is quick and exact.
///
/// What follows the number is the caller's to judge: it may belong to it, as an exponent does.
#[inline(always)]
pub(crate) fn leading_number(bytes: &[u8]) -> Option<(f64, usize)> {
    let (negative, digits) = match bytes {
        [b'-', rest @ ..] => (true, rest),
        rest => (false, rest),
    };
    let mut mantissa = 0_u64;
    let whole = accumulate(digits, &mut mantissa);
    let mut length = whole;
    let mut n_decimals = 0;
    if digits.get(whole) == Some(&b'.') {
        n_decimals = accumulate(&digits[whole + 1..], &mut mantissa);
        length += 1 + n_decimals;
    }
    let n_digits = whole + n_decimals;
    // 19 digits always fit into 64 bits; more may have wrapped around.
    if n_digits == 0 || n_digits > 19 {
        return None;
    }
    let value = quotient(mantissa, n_decimals)?;
    Some(if negative { (-value, length + 1) } else { (value, length) })
}

/// Returns `mantissa / 10^n_decimals`, rounded to nearest, for up to 19 decimals; `None` in rare cases.
///
/// Below 2^53 both are doubles and their quotient is rounded once (Clinger 1990). Above, the quotient
/// of the rounded mantissa is at most a unit in the last place away, and exact integers tell by how much.
#[inline(always)]
fn quotient(mantissa: u64, n_decimals: usize) -> Option<f64> {
    if mantissa < 1 << 53 {
        // Signed integers are converted in one instruction.
        return Some(mantissa as i64 as f64 / EXACT_POWERS[n_decimals]);
    }
    corrected(mantissa, n_decimals, mantissa as f64 / EXACT_POWERS[n_decimals])
}

#[inline(never)]
fn corrected(mantissa: u64, n_decimals: usize, near: f64) -> Option<f64> {
    const IMPLICIT: u64 = 1 << 52;
    let bits = near.to_bits();
    // near = significand / 2^shift
    let significand = (bits & (IMPLICIT - 1)) | IMPLICIT;
    let shift = 1075_u64.checked_sub(bits >> 52).filter(|shift| (1..=63).contains(shift))?;
    // Next to a power of two the spacing of doubles changes.
    if !(IMPLICIT + 2..2 * IMPLICIT - 2).contains(&significand) {
        return None;
    }
    let power = i128::from(10_u64.pow(n_decimals as u32));
    // Both products are close to each other and below 2^53 * 10^19 < 2^117.
    let mut excess = (i128::from(mantissa) << shift) - i128::from(significand) * power;
    let mut steps = 0_i64;
    while 2 * excess.abs() > power {
        steps += excess.signum() as i64;
        excess -= excess.signum() * power;
    }
    let odd = (significand as i64 + steps) & 1 == 1;
    if odd && 2 * excess.abs() == power {
        steps += excess.signum() as i64;
    }
    // Fewer than two steps were taken, so the significand still has 53 bits.
    (steps.abs() <= 1).then(|| f64::from_bits(bits.wrapping_add_signed(steps)))
}

/// Appends the leading digits of `bytes` to `mantissa` and returns how many there are.
#[inline(always)]
fn accumulate(bytes: &[u8], mantissa: &mut u64) -> usize {
    const POWERS: [u64; 16] =
        [1, 10, 100, 1000, 10_000, 100_000, 1_000_000, 10_000_000, 100_000_000, 0, 0, 0, 0, 0, 0, 0];
    let mut n = 0;
    while let Some(chunk) = bytes.get(n..n + 8) {
        let (value, count) = up_to_eight_digits(chunk);
        *mantissa = mantissa.wrapping_mul(POWERS[count & 15]).wrapping_add(value);
        n += count;
        if count < 8 {
            return n;
        }
    }
    while let Some(digit) = bytes.get(n).map(|byte| byte.wrapping_sub(b'0')).filter(|digit| *digit < 10) {
        *mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(digit));
        n += 1;
    }
    n
}

/// Returns the value of the leading digits of eight bytes, and how many digits there are.
#[inline(always)]
fn up_to_eight_digits(chunk: &[u8]) -> (u64, usize) {
    let Ok(eight) = chunk.try_into() else { return (0, 0) };
    let word = u64::from_le_bytes(eight);
    let values = word.wrapping_sub(0x3030_3030_3030_3030);
    // A byte below '0' borrows, one above '9' carries: either sets a high bit. Only later bytes are
    // disturbed by that, so the first of them is told exactly.
    let others = (values | word.wrapping_add(0x4646_4646_4646_4646)) & 0x8080_8080_8080_8080;
    let count = others.trailing_zeros() as usize / 8;
    // The digits move to the end, which leaves zeros in front of them.
    let digits = if count == 0 { 0 } else { values << (64 - 8 * count) };
    // Neighbours are joined: eight digits to four pairs, to two quadruples, to one number.
    let pairs = (digits.wrapping_mul(10) + (digits >> 8)) & 0x00ff_00ff_00ff_00ff;
    let quadruples = (pairs.wrapping_mul(100) + (pairs >> 16)) & 0x0000_ffff_0000_ffff;
    ((quadruples.wrapping_mul(10_000) + (quadruples >> 32)) & 0xffff_ffff, count)
}

/// Returns the number that the standard library reads.
#[cold]
fn parse_slowly(token: &[u8]) -> Option<f64> {
    std::str::from_utf8(token).ok()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn check(token: &str) {
        let expected = token.parse::<f64>().ok();
        let found = parse_number(token.as_bytes());
        assert_eq!(found.map(f64::to_bits), expected.map(f64::to_bits), "`{token}`: {found:?}, {expected:?}");
    }

    #[test]
    fn numbers_are_those_of_the_standard_library() {
        for token in [
            "0",
            "-0",
            "1.",
            ".5",
            "-.5",
            "783.557685",
            "277.3219909667969",
            "199.77850341796875",
            "9007199254740993",
            "9007199254740991",
            "0.1",
            "1e5",
            "1.0e-05",
            "-12.5E+3",
            "1e400",
            "4.9e-324",
            "2.4703282292062328e-324",
            "00000000000000000000000000001",
            "18446744073709551616",
            "0.00000000000000000000000000001",
            "+1.5",
            "nan",
            "inf",
            "-inf",
            "NaN",
            "",
            ".",
            "-",
            "e5",
            "1..2",
            "1.2.3",
            "12a",
            "1 ",
            "--1",
            "１",
            "12345678",
            "1234567:",
            "1234567/",
            "12345678.12345678",
            "123456789012345678901234567890",
        ] {
            check(token);
        }
    }

    proptest! {
        #[test]
        fn any_double_survives(bits: u64) {
            let value = f64::from_bits(bits);
            check(&format!("{value}"));
            check(&format!("{value:e}"));
            check(&format!("{value:.6}"));
        }

        #[test]
        fn pixels_survive(value in -10_000.0..10_000.0_f64, decimals in 0_usize..18) {
            check(&format!("{value:.decimals$}"));
            check(&format!("{}", value as f32));
        }

        #[test]
        fn long_mantissas_are_rounded_alike(mantissa: u64, decimals in 0_usize..20) {
            let digits = format!("{mantissa:020}");
            check(&format!("{}.{}", &digits[..20 - decimals], &digits[20 - decimals..]));
            let near_tie = format!("{}5", (mantissa >> 11) | 1);
            check(&format!("{}.{}", &near_tie[..1], &near_tie[1..]));
        }

        #[test]
        fn any_text_is_judged_alike(token in "[-+0-9.eE]{0,24}") {
            check(&token);
        }
    }
}
