//! What every transport of this crate does: a request for a page is answered with that page's bytes.

use core::sync::atomic::{AtomicBool, Ordering};
use std::os::fd::AsFd;
use std::os::unix::fs::FileExt;
use std::sync::Arc;
use std::thread;

use dsm_core::home::Home;
use dsm_core::id::{ClusterId, Epoch, Incarnation, NodeId, PageId};
use dsm_core::placement::Stripes;
use dsm_core::transport::{Lossy, Received, SendError, Transport};
use dsm_core::wire::{Body, HEADER_BYTES, Message, Refusal};
use transport_shm::{ChannelId, DirectPort, Inbox, Layout, PageFile, RingPort, Server, now};

const PAGE_BYTES: u32 = 4096;
const READER: NodeId = NodeId(0);
const OWNER: NodeId = NodeId(1);
const SECOND_US: u64 = 1_000_000;

fn placement() -> Stripes {
    Stripes::new(8, 1, READER, 2).unwrap()
}

fn home() -> Home {
    Home::new(OWNER, ClusterId(7), Epoch(1), placement(), PAGE_BYTES)
}

/// The owner's pages 1, 3, 5, 7; every byte of one is its page number.
fn pages() -> Arc<PageFile> {
    let pages = PageFile::create(4 * u64::from(PAGE_BYTES)).unwrap();
    for page in [1u8, 3, 5, 7] {
        let bytes = [page; PAGE_BYTES as usize];
        pages.file().write_all_at(&bytes, u64::from(page / 2) * u64::from(PAGE_BYTES)).unwrap();
    }
    pages.freeze().unwrap();
    Arc::new(pages)
}

fn request(page: u32, number: u32) -> [u8; HEADER_BYTES] {
    let mut bytes = [0; HEADER_BYTES];
    let (cluster, epoch, page) = (ClusterId(7), Epoch(1), PageId(page));
    Message {
        cluster,
        epoch,
        from: READER,
        to: OWNER,
        page,
        request: number,
        stamp_us: 0,
        from_incarnation: Incarnation(0),
        to_incarnation: Incarnation(0),
        body: Body::REQUEST,
    }
    .emit(&mut bytes);
    bytes
}

fn bytes_of(received: &Received<'_>) -> Vec<u8> {
    let mut bytes = vec![0; received.body.len()];
    // SAFETY: the body is readable as long as `received` borrows the transport, and `bytes` is as long as it.
    unsafe { core::ptr::copy_nonoverlapping(received.body.as_ptr(), bytes.as_mut_ptr(), bytes.len()) };
    bytes
}

/// The contract, for a port that reaches `OWNER`.
fn check(port: &mut impl Transport) {
    for (number, page) in [1u32, 7, 3, 5, 5, 1].into_iter().cycle().take(200).enumerate() {
        let number = u32::try_from(number).unwrap();
        port.send(OWNER, &request(page, number)).unwrap();
        let received = port.receive(now().after(10 * SECOND_US)).expect("an answer in time");
        let message = Message::parse(&received.header).unwrap();
        assert_eq!((message.page, message.request), (PageId(page), number));
        assert_eq!((message.from, message.to), (OWNER, READER));
        assert_eq!(message.body, Body::Grant { offset: 0, bytes: PAGE_BYTES });
        assert_eq!(bytes_of(&received), vec![u8::try_from(page).unwrap(); PAGE_BYTES as usize]);
    }
    port.send(OWNER, &request(2, 900)).unwrap();
    let received = port.receive(now().after(10 * SECOND_US)).expect("an answer in time");
    assert_eq!(Message::parse(&received.header).unwrap().body, Body::Refusal(Refusal::NotOwner));

    assert_eq!(port.send(NodeId(5), &request(1, 901)), Err(SendError::NoRoute(NodeId(5))));
    let mut stranger = request(1, 902);
    stranger[4] ^= 1;
    port.send(OWNER, &stranger).unwrap();
    assert!(port.receive(now().after(20_000)).is_none(), "a stranger's request gets no answer");
}

/// Runs `test` beside a server thread, on ports to as many channels as asked for.
fn beside_a_server<const PORTS: u16>(spin_us: u64, test: impl FnOnce(Vec<RingPort>)) {
    let layout = Layout::new(PAGE_BYTES, PORTS).unwrap();
    let inbox = Inbox::create(layout).unwrap();
    let inbox = Inbox::open(inbox.as_fd().try_clone_to_owned().unwrap(), layout).unwrap();
    let ports = (0..PORTS).map(|channel| {
        let mut port = RingPort::new(spin_us);
        port.connect(OWNER, &inbox, layout, ChannelId(channel)).unwrap();
        port
    });
    let ports = ports.collect();
    let mut server = Server::new(home(), pages(), &inbox, layout, spin_us).unwrap();
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !stop.load(Ordering::Relaxed) {
                server.serve(now().after(5_000));
            }
        });
        test(ports);
        stop.store(true, Ordering::Relaxed);
    });
}

#[test]
fn direct_reads_keep_the_contract() {
    let mut port = DirectPort::new(PAGE_BYTES);
    port.connect(OWNER, home(), pages());
    check(&mut port);
}

#[test]
fn rings_keep_the_contract_asleep_and_awake() {
    for spin_us in [0, 100] {
        beside_a_server::<1>(spin_us, |mut ports| check(&mut ports[0]));
    }
}

#[test]
fn several_threads_are_served_side_by_side() {
    beside_a_server::<4>(0, |ports| {
        thread::scope(|scope| {
            for mut port in ports {
                scope.spawn(move || check(&mut port));
            }
        });
    });
}

#[test]
fn a_client_that_never_takes_its_answers_stops_nobody() {
    beside_a_server::<2>(0, |mut ports| {
        let mut polite = ports.pop().unwrap();
        let rude = &mut ports[0];
        for number in 0..50 {
            let _ = rude.send(OWNER, &request(1, number));
        }
        check(&mut polite);
        // Its own later requests are answered again once it takes what is there.
        while rude.receive(now().after(50_000)).is_some() {}
        rude.send(OWNER, &request(3, 99)).unwrap();
        let received = rude.receive(now().after(10 * SECOND_US)).expect("an answer in time");
        assert_eq!(Message::parse(&received.header).unwrap().request, 99);
    });
}

#[test]
fn an_owner_whose_memory_is_too_short_refuses() {
    let mut port = DirectPort::new(PAGE_BYTES);
    port.connect(OWNER, home(), Arc::new(PageFile::create(u64::from(PAGE_BYTES)).unwrap()));
    port.send(OWNER, &request(7, 1)).unwrap();
    let received = port.receive(now()).expect("an answer");
    assert_eq!(Message::parse(&received.header).unwrap().body, Body::Refusal(Refusal::Unreadable));
}

#[test]
fn frozen_pages_cannot_be_written_by_anybody() {
    let pages = pages();
    assert!(pages.file().write_all_at(&[1], 0).is_err());
    assert!(pages.file().set_len(0).is_err());
}

#[test]
fn a_lossy_transport_loses_what_its_seed_says() {
    let answered = |seed| {
        let mut inner = DirectPort::new(PAGE_BYTES);
        inner.connect(OWNER, home(), pages());
        let mut port = Lossy::new(inner, 300, seed);
        let ask = |number| {
            port.send(OWNER, &request(1, number)).unwrap();
            port.receive(now())
                .is_some_and(|received| Message::parse(&received.header).unwrap().request == number)
        };
        (0..200).map(ask).collect::<Vec<bool>>()
    };
    assert_eq!(answered(4), answered(4));
    let count = answered(4).into_iter().filter(|answered| *answered).count();
    assert!((60..140).contains(&count), "0.7 * 0.7 of 200 is 98, got {count}");
}

#[test]
fn an_inbox_that_could_be_cut_short_is_not_opened() {
    let layout = Layout::new(PAGE_BYTES, 1).unwrap();
    let file = PageFile::create(64).unwrap();
    assert!(Inbox::open(file.as_fd().try_clone_to_owned().unwrap(), layout).is_err());
    assert!(Layout::new(5000, 1).is_err());
    assert!(Layout::new(PAGE_BYTES, 0).is_err());
}
