//! Counts the messages of MCAP files by topic, whole or cut short: `FILE TOPIC COUNT` a line.
//! Like any linear reader it stops where a file breaks off, and counts what came before.

use std::collections::BTreeMap;
use std::{env, fs};

use mcap::records::Record;
use mcap::read::{ChunkFlattener, Options};

fn main() {
    for path in env::args().skip(1) {
        let data = fs::read(&path).expect("the file can be read");
        let mut topics: BTreeMap<u16, String> = BTreeMap::new();
        let mut counts: BTreeMap<String, u64> = BTreeMap::new();
        let options = Options::IgnoreEndMagic;
        let records = ChunkFlattener::new_with_options(&data, options.into()).expect("an MCAP file");
        for record in records {
            match record {
                Ok(Record::Channel(channel)) => {
                    topics.insert(channel.id, channel.topic);
                }
                Ok(Record::Message { header, .. }) => {
                    *counts.entry(topics[&header.channel_id].clone()).or_default() += 1;
                }
                Ok(_) => {}
                Err(_) => break,
            }
        }
        for (topic, count) in counts {
            println!("{path} {topic} {count}");
        }
    }
}
