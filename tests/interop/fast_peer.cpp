// A participant of Fast DDS that is told what to do by lines on its standard input, and says what it
// hears by lines on its standard output. Messages are CDR as hexadecimal digits: who talks to it
// knows what is in them (fast_peer.py), and this program needs no types.
//
//   reader NAME TOPIC TYPE     hears a topic:            NAME DIGITS
//   writer NAME TOPIC TYPE     may write a topic
//   write NAME DIGITS          writes
//   client NAME SERVICE TYPE   may call a service
//   call NAME DIGITS           calls it, as rmw_fastrtps does: the request carries in its metadata
//                              the reader that waits for the reply: NAME DIGITS
//   matched NAME               how many are on the other side:    NAME NUMBER
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/common/WriteParams.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::GUID_t;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SampleIdentity;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using eprosima::fastrtps::rtps::WriteParams;
using Bytes = std::vector<unsigned char>;

// Any type: its bytes.
struct Raw : TopicDataType {
    explicit Raw(const std::string& name) {
        setName(name.c_str());
        m_typeSize = 65536;
        m_isGetKeyDefined = false;
        auto_fill_type_object(false);
        auto_fill_type_information(false);
    }
    bool serialize(void* data, SerializedPayload_t* payload) override {
        const Bytes& bytes = *static_cast<Bytes*>(data);
        payload->encapsulation = CDR_LE;
        payload->length = bytes.size();
        std::memcpy(payload->data, bytes.data(), bytes.size());
        return true;
    }
    bool deserialize(SerializedPayload_t* payload, void* data) override {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
    }
    void* createData() override { return new Bytes; }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

std::mutex printing;

void print(const std::string& name, const std::string& text) {
    std::lock_guard<std::mutex> lock(printing);
    std::cout << name << ' ' << text << std::endl;
}

// Prints what comes; where it is for replies, only those to its own requests.
struct Printer : DataReaderListener {
    std::string name;
    bool replies = false;

    void on_data_available(DataReader* reader) override {
        Bytes bytes;
        SampleInfo info;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
            const GUID_t asked = info.related_sample_identity.writer_guid();
            if (!info.valid_data || (replies && asked != reader->guid())) continue;
            static const char digits[] = "0123456789abcdef";
            std::string text;
            for (unsigned char byte : bytes) {
                text += digits[byte >> 4];
                text += digits[byte & 15];
            }
            print(name, text);
        }
    }
};

Bytes from_digits(const std::string& text) {
    Bytes bytes;
    for (size_t at = 0; at + 1 < text.size(); at += 2)
        bytes.push_back(std::stoi(text.substr(at, 2), nullptr, 16));
    return bytes;
}

struct Peer {
    DomainParticipant* participant;
    Publisher* publisher;
    Subscriber* subscriber;
    std::map<std::string, DataReader*> readers;
    std::map<std::string, DataWriter*> writers;
    std::vector<std::unique_ptr<Printer>> printers;

    explicit Peer(uint32_t domain) {
        DomainParticipantQos qos;
        participant = DomainParticipantFactory::get_instance()->create_participant(domain, qos);
        if (!participant) std::exit(1);
        publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
        subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    }

    Topic* topic(const std::string& name, const std::string& type) {
        TypeSupport(new Raw(type)).register_type(participant);
        return participant->create_topic(name, type, TOPIC_QOS_DEFAULT);
    }

    void reader(const std::string& name, Topic* of, bool replies) {
        DataReaderQos qos;
        qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
        qos.history().depth = 10;
        printers.emplace_back(new Printer);
        printers.back()->name = name;
        printers.back()->replies = replies;
        readers[name] = subscriber->create_datareader(of, qos, printers.back().get());
    }

    void writer(const std::string& name, Topic* of) {
        DataWriterQos qos;
        qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
        qos.history().depth = 10;
        writers[name] = publisher->create_datawriter(of, qos);
    }

    int matched(const std::string& name) {
        int both = 1 << 30;
        if (writers.count(name)) {
            PublicationMatchedStatus status;
            writers[name]->get_publication_matched_status(status);
            both = std::min(both, static_cast<int>(status.current_count));
        }
        if (readers.count(name)) {
            SubscriptionMatchedStatus status;
            readers[name]->get_subscription_matched_status(status);
            both = std::min(both, static_cast<int>(status.current_count));
        }
        return both;
    }

    bool obey(const std::string& line) {
        std::istringstream words(line);
        std::string what, name, where, type;
        words >> what >> name >> where >> type;
        if (what == "reader") {
            reader(name, topic(where, type), false);
        } else if (what == "writer") {
            writer(name, topic(where, type));
        } else if (what == "client") {
            writer(name, topic("rq/" + where + "Request", type + "_Request_"));
            reader(name, topic("rr/" + where + "Reply", type + "_Response_"), true);
        } else if (what == "write") {
            Bytes bytes = from_digits(where);
            return writers.at(name)->write(&bytes);
        } else if (what == "call") {
            Bytes bytes = from_digits(where);
            WriteParams params;
            params.related_sample_identity().writer_guid() = readers.at(name)->guid();
            return writers.at(name)->write(&bytes, params);
        } else if (what == "matched") {
            print(name, std::to_string(matched(name)));
        } else {
            return false;
        }
        return true;
    }
};

int main(int, char** arguments) {
    Peer peer(std::stoul(arguments[1]));
    for (std::string line; std::getline(std::cin, line);) {
        if (!peer.obey(line)) std::cerr << "not done: " << line << std::endl;
    }
    std::_Exit(0);
}
