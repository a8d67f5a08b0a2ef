//! A recording stays readable wherever it ends: cut at any byte, or on a disk that is full.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Read, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex};

use heliostat_record::account::Account;
use heliostat_record::file::{self, Entry, Header, Reading, Recording, RecordingError, Storage};
use mcap::records::{MessageHeader, Metadata, Record};
use mcap::{Compression, WriteOptions};

const KEY: &str = "heliostat/v1/a/users";

/// A disk of limited size whose bytes the test can see.
#[derive(Clone)]
struct Disk {
    bytes: Arc<Mutex<Vec<u8>>>,
    size: usize,
}

impl Disk {
    fn new(size: usize) -> Self {
        Self { bytes: Arc::default(), size }
    }

    fn bytes(&self) -> Vec<u8> {
        self.bytes.lock().unwrap().clone()
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut disk = self.bytes.lock().unwrap();
        let taken = bytes.len().min(self.size - disk.len());
        if taken == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        disk.extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        assert_eq!(to, SeekFrom::Current(0), "a recording is written sequentially");
        Ok(self.bytes.lock().unwrap().len() as u64)
    }
}

impl Storage for Disk {
    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.bytes.lock().unwrap().truncate(length as usize);
        Ok(())
    }

    fn settle(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn header() -> Header {
    Header { room: "a".into(), scenario: "seed = 3".into(), contract: "1".into(), ..Header::default() }
}

fn payload(index: u64) -> Vec<u8> {
    [b"message ".as_slice(), index.to_string().as_bytes()].concat()
}

fn read(source: impl Read) -> Result<Vec<Entry>, RecordingError> {
    let mut reading = Reading::open(source)?;
    let mut entries = Vec::new();
    while let Some(entry) = reading.entry()? {
        entries.push(entry);
    }
    Ok(entries)
}

fn assert_first(entries: &[Entry], count: usize) {
    assert_eq!(entries.len(), count);
    for (index, entry) in entries.iter().enumerate() {
        let index = index as u64;
        let expected = Entry { topic: KEY.into(), arrived_ns: 100 + index, data: payload(index) };
        assert_eq!(*entry, expected);
    }
}

#[test]
fn a_recording_is_read_with_header_messages_and_account() {
    let disk = Disk::new(usize::MAX);
    let mut recording = Recording::create(disk.clone(), &header()).unwrap();
    for index in 0..50 {
        recording.payload(KEY, 100 + index, index, &payload(index)).unwrap();
    }
    let mut account = Account::default();
    account.count(KEY, 9, None);
    recording.finish(&account).unwrap();
    let bytes = disk.bytes();
    let mut reading = Reading::open(bytes.as_slice()).unwrap();
    assert_eq!(*reading.header(), header());
    let mut count = 0;
    while reading.entry().unwrap().is_some() {
        count += 1;
    }
    assert_eq!(count, 50);
    let counts: serde_json::Value = serde_json::from_str(reading.account().unwrap()).unwrap();
    assert_eq!(counts["streams"][KEY]["unreadable"], 1);
    // The index that viewers jump by, as another reader sees it.
    let summary = mcap::Summary::read(&bytes).unwrap().expect("a finished file has a summary");
    assert_eq!(summary.stats.unwrap().message_count, 50);
}

#[test]
fn bytes_after_the_end_of_a_recording_are_an_error_that_counts_them() {
    let disk = Disk::new(usize::MAX);
    let mut recording = Recording::create(disk.clone(), &header()).unwrap();
    recording.payload(KEY, 100, 0, &payload(0)).unwrap();
    recording.finish(&Account::default()).unwrap();
    let bytes = disk.bytes();
    assert_first(&read(bytes.as_slice()).unwrap(), 1);
    for more in [&bytes[..], &b"x"[..]] {
        let joined = [&bytes[..], more].concat();
        let error = read(joined.as_slice()).unwrap_err().to_string();
        assert!(error.contains(&format!("after the end of its recording, by {} bytes", more.len())), "{error}");
    }
}

#[cfg(unix)]
#[test]
fn what_is_no_regular_file_is_no_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.mcap");
    let _socket = std::os::unix::net::UnixListener::bind(&path).unwrap();
    let error = file::open(&path).err().expect("refused").to_string();
    assert!(error.contains("no regular file"), "{error}");
}

#[test]
fn a_file_cut_at_any_byte_holds_every_complete_chunk_before_the_cut() {
    let disk = Disk::new(usize::MAX);
    let mut recording = Recording::create(disk.clone(), &header()).unwrap();
    let mut complete = vec![(disk.bytes().len(), 0)];
    for index in 0..40 {
        recording.payload(KEY, 100 + index, index, &payload(index)).unwrap();
        if index % 8 == 7 {
            recording.flush().unwrap();
            complete.push((disk.bytes().len(), index as usize + 1));
        }
    }
    recording.finish(&Account::default()).unwrap();
    let bytes = disk.bytes();
    for cut in 0..=bytes.len() {
        let kept = complete.iter().rev().find(|(length, _)| *length <= cut);
        match (read(&bytes[..cut]), kept) {
            (Ok(entries), Some((_, count))) => {
                // A chunk is complete before the index that follows it.
                assert!(entries.len() == *count || entries.len() == count + 8, "cut at {cut}: {}", entries.len());
                assert_first(&entries, entries.len());
            }
            (Ok(entries), None) => assert!(entries.is_empty(), "cut at {cut}"),
            (Err(error), kept) => assert!(kept.is_none(), "cut at {cut}: {error}"),
        }
    }
}

#[test]
fn a_full_disk_is_reported_and_leaves_a_complete_file() {
    let mut ended = 0;
    for size in (600..6000).step_by(97) {
        let disk = Disk::new(size);
        let begun = Recording::create(disk.clone(), &header());
        let mut recording = match begun {
            Ok(recording) => recording,
            Err(error) => panic!("the header alone fits into {size} bytes: {error}"),
        };
        let mut taken = 0;
        let error = loop {
            let put = recording.payload(KEY, 100 + taken, taken, &payload(taken));
            let put = put.and_then(|()| if taken % 8 == 7 { recording.flush() } else { Ok(()) });
            taken += 1;
            if let Err(error) = put {
                break error;
            }
        };
        let RecordingError::Full { written, lost } = error else { panic!("{error}") };
        assert_eq!(written + lost, taken, "nothing is lost silently");
        assert!(matches!(recording.payload(KEY, 0, 0, b"more"), Err(RecordingError::Write { .. })));
        let bytes = disk.bytes();
        assert!(bytes.len() <= size);
        assert_first(&read(bytes.as_slice()).unwrap(), written as usize);
        // Another reader needs a proper end; it fits unless the disk was full to its last bytes.
        if bytes.ends_with(mcap::MAGIC) {
            let others = mcap::MessageStream::new(&bytes).unwrap().map(|message| message.expect("complete"));
            assert_eq!(others.count() as u64, written);
            ended += 1;
        } else {
            assert!(size - bytes.len() < 50, "{} of {size} bytes", bytes.len());
        }
    }
    assert!(ended > 20, "{ended}");
}

#[test]
fn a_damaged_chunk_is_refused_with_what_to_do() {
    let mut bytes = include_bytes!("../../../../tests/data/golden.mcap").to_vec();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0xff;
    let refusal = read(Cursor::new(bytes)).expect_err("a damaged chunk").to_string();
    assert!(refusal.ends_with("; copy the file again, or repair it with `mcap recover`"), "{refusal}");
}

#[test]
fn a_file_that_is_not_a_recording_is_refused_with_the_reason() {
    let refusal = |bytes: &[u8]| read(Cursor::new(bytes.to_vec())).expect_err("no recording").to_string();
    assert!(refusal(b"some text that is long enough to be looked at").contains("is not an MCAP file"), "a text file");
    let mut foreign = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
    foreign.finish().unwrap();
    assert!(refusal(foreign.into_inner().get_ref()).contains("not a recording of a room"));
    let disk = Disk::new(usize::MAX);
    let later = Header { contract: "2".into(), ..header() };
    Recording::create(disk.clone(), &later).unwrap().finish(&Account::default()).unwrap();
    assert!(refusal(&disk.bytes()).contains("version 2 of the contract"), "a recording from the future");
}

#[test]
fn a_file_of_another_kind_is_named_with_what_to_do() {
    let file = tempfile::NamedTempFile::new().unwrap();
    for (bytes, words) in [
        (
            &b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n"[..],
            "is a pointer of git-lfs, expected a recording",
        ),
        (b"", "is empty"),
        (b"hello", "is not an MCAP file; expected a file made by `heliostat record`"),
        (
            b"name = \"hall\"\n[room]\nlength_x_m = 5\n",
            "is not an MCAP file; expected a file made by `heliostat record`",
        ),
    ] {
        std::fs::write(file.path(), bytes).unwrap();
        let refusal = file::open(file.path()).err().expect("no recording").to_string();
        assert!(refusal.starts_with("the file ") && refusal.contains(words), "{refusal}");
    }
}

/// Ten messages as other tools write them: in compressed chunks, or with the metadata at the end.
fn rewritten(compression: Option<Compression>, metadata_first: bool) -> tempfile::NamedTempFile {
    let disk = Disk::new(usize::MAX);
    let mut recording = Recording::create(disk.clone(), &header()).unwrap();
    (0..10).for_each(|index| recording.payload(KEY, 100 + index, index, &payload(index)).unwrap());
    recording.finish(&Account::default()).unwrap();
    let bytes = disk.bytes();
    let records = mcap::read::LinearReader::new(&bytes).unwrap().map(Result::unwrap);
    let metadata: Vec<Metadata> =
        records.filter_map(|record| if let Record::Metadata(found) = record { Some(found) } else { None }).collect();
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut writer = WriteOptions::new().compression(compression).create(file.reopen().unwrap()).unwrap();
    let write_metadata = |writer: &mut mcap::Writer<_>| {
        metadata.iter().for_each(|metadata| writer.write_metadata(metadata).unwrap());
    };
    if metadata_first {
        write_metadata(&mut writer);
    }
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    if !metadata_first {
        write_metadata(&mut writer);
    }
    writer.finish().unwrap();
    file
}

#[test]
fn a_small_file_whose_chunk_declares_more_than_is_accepted_is_refused_with_both_lengths() {
    let map = serde_json::from_value(serde_json::to_value(header()).unwrap()).unwrap();
    // Without a checksum: the library compares no length then.
    let options = WriteOptions::new().compression(Some(Compression::Zstd)).chunk_size(None).calculate_chunk_crcs(false);
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    writer.write_metadata(&Metadata { name: "heliostat".into(), metadata: map }).unwrap();
    let channel_id = writer.add_channel(0, KEY, "heliostat.v1", &BTreeMap::new()).unwrap();
    let payload = vec![0; 1 << 20];
    for sequence in 0..65 {
        let header = MessageHeader { channel_id, sequence, log_time: 100, publish_time: 100 };
        writer.write_to_known_channel(&header, &payload).unwrap();
    }
    writer.finish().unwrap();
    let bytes = writer.into_inner().into_inner();
    assert!(bytes.len() < 1 << 20, "{}", bytes.len());
    let error = read(bytes.as_slice()).unwrap_err().to_string();
    assert!(error.starts_with("the recording cannot be read: a chunk declares 6"), "{error}");
    assert!(error.contains("expected at most 67108864: write the file again with smaller chunks"), "{error}");
}

#[test]
fn a_file_that_other_tools_compressed_or_rewrote_is_read() {
    for (compression, metadata_first) in [
        (None, true),
        (None, false),
        (Some(Compression::Zstd), true),
        (Some(Compression::Lz4), true),
        (Some(Compression::Zstd), false),
    ] {
        let file = rewritten(compression, metadata_first);
        let mut reading = file::open(file.path()).unwrap();
        assert_eq!(*reading.header(), header(), "{compression:?}");
        let mut entries = Vec::new();
        while let Some(entry) = reading.entry().unwrap() {
            entries.push(entry);
        }
        assert_first(&entries, 10);
    }
}
