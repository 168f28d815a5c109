//! Attributes of a file that were not read, counted by kind.

use super::tag::Tag;

/// Kind of an attribute that is left unread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Patient,
    Person,
    Time,
    Identifier,
    Private,
    Other,
}

/// Numbers of attributes that were left unread. Their values are not known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LeftUnread {
    counts: [usize; KINDS.len()],
}

/// The kinds with their names, for one and for several.
const KINDS: [(Kind, &str, &str); 6] = [
    (Kind::Patient, "about the patient", "about the patient"),
    (Kind::Person, "name of a person", "names of people"),
    (Kind::Time, "date or time", "dates and times"),
    (Kind::Identifier, "identifier", "identifiers"),
    (Kind::Private, "private attribute", "private attributes"),
    (Kind::Other, "other", "others"),
];

/// Group of the attributes of patients.
const PATIENT_GROUP: u16 = 0x0010;

impl LeftUnread {
    /// Counts an attribute; `vr` is its type, if the file says it.
    pub(super) fn count(&mut self, tag: Tag, vr: Option<[u8; 2]>) {
        self.counts[kind(tag, vr) as usize] += 1;
    }

    /// Adds the counts of another file.
    pub(crate) fn add(&mut self, other: &Self) {
        self.counts.iter_mut().zip(other.counts).for_each(|(mine, more)| *mine += more);
    }

    /// Describes the counts in words; `None` if there is nothing.
    pub(crate) fn describe(&self) -> Option<String> {
        let part = |(kind, one, several): &(Kind, &str, &str)| {
            let n = self.counts[*kind as usize];
            (n > 0).then(|| format!("{n} {}", if n == 1 { one } else { several }))
        };
        let parts: Vec<String> = KINDS.iter().filter_map(part).collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}

fn kind(tag: Tag, vr: Option<[u8; 2]>) -> Kind {
    let Tag(group, element) = tag;
    if group % 2 == 1 {
        return Kind::Private;
    }
    if group == PATIENT_GROUP {
        return Kind::Patient;
    }
    match vr.as_ref() {
        Some(b"PN") => Kind::Person,
        Some(b"DA" | b"TM" | b"DT") => Kind::Time,
        Some(b"UI") => Kind::Identifier,
        Some(_) => Kind::Other,
        // Types that the file does not say: the usual places of such attributes (PS3.6).
        None => match (group, element) {
            (0x0008, 0x0090 | 0x1048 | 0x1050 | 0x1060 | 0x1070) | (0x0070, 0x0084) => Kind::Person,
            (0x0008, 0x0012..=0x0013 | 0x0020..=0x0035) | (0x0040, 0x0244..=0x0251) => Kind::Time,
            (0x0008, 0x0014 | 0x0018 | 0x0050) | (0x0020, 0x000d..=0x0010 | 0x0052) => Kind::Identifier,
            _ => Kind::Other,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_are_counted_by_kind() {
        let mut left = LeftUnread::default();
        assert_eq!(left.describe(), None);
        left.count(Tag(0x0010, 0x0010), None);
        left.count(Tag(0x0008, 0x0090), Some(*b"PN"));
        left.count(Tag(0x0008, 0x1050), None);
        left.count(Tag(0x0009, 0x1001), Some(*b"DA"));
        let said = left.describe().unwrap();
        assert_eq!(said, "1 about the patient, 2 names of people, 1 private attribute");
    }
}
