//! Time stamps: ISO 8601 in UTC with milliseconds, `YYYY-MM-DDTHH:mm:ss.fffZ`.

/// Milliseconds of one day.
const DAY_MS: u64 = 86_400_000;

/// The time stamp of so many milliseconds since 1970-01-01, without leap seconds, as in Unix time.
///
/// The date follows from the days since 0000-03-01: counted from March, a leap day is the last of
/// its year, and months have 153 days in every five.
#[must_use]
pub fn stamp(unix_ms: u64) -> String {
    let (days, ms) = (unix_ms / DAY_MS, unix_ms % DAY_MS);
    // 719 468 days lie between 0000-03-01 and 1970-01-01; 146 097 are the days of 400 years.
    let days = days + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let leap = day_of_era / 1_460 + day_of_era / 146_096 - day_of_era / 36_524;
    let year_of_era = (day_of_era - leap) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 {
        shifted_month + 3
    } else {
        shifted_month - 9
    };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (seconds, ms) = (ms / 1_000, ms % 1_000);
    let (hour, minute, second) = (seconds / 3_600, seconds / 60 % 60, seconds % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}Z")
}
